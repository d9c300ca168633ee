"""What `predict.py` needs of bags; the package rosbags is imported when a bag is read or written."""

from pathlib import Path

from omniocc.errors import DataError, UserError, installing
from omniocc.extras.recorders.bag import Bag
from omniocc.extras.recorders.bag_frames import read_bag
from omniocc.predict.output.bag import BagContent, Bags


def replaceable(path: Path) -> bool:
    """Return whether a file is a bag of predictions alone."""
    from omniocc.extras.recorders.bag_writer import TOPICS

    try:
        with Bag(path) as bag:
            return {connection.topic for connection in bag.reader.connections} <= TOPICS
    except DataError:
        return False


def write(path: Path, content: BagContent) -> None:
    """Write predictions as a bag; errors are those of `omniocc.extras.recorders.bag_writer.write_bag`.

    Raises:
        UserError: if the package rosbags is missing.
    """
    try:
        from omniocc.extras.recorders.bag_writer import write_bag
    except ImportError as error:
        raise UserError(f"bags are written by the package rosbags: {installing('bag')}") from error
    write_bag(path, content)


BAGS = Bags(read_bag, replaceable, write)
