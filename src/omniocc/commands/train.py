"""Train a model, test its best checkpoint on unseen scenes, write figures and images; options: `--help`."""

from collections.abc import Callable

from omegaconf import DictConfig

from omniocc.runs.script import quiet_libraries, script


def work() -> Callable[[DictConfig], None]:
    """Import and return what trains; a multirun imports it once for all jobs (`omniocc.runs.fork_server`)."""
    from omniocc.train.command import train

    return train


@script("train", "the same command goes on")
def main(cfg: DictConfig) -> None:
    """Run the stages of the configuration that are missing."""
    train = work()
    quiet_libraries()  # Lightning sets its own level when it is imported
    train(cfg)


if __name__ == "__main__":
    main()
