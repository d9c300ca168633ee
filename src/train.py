"""Train a model, test its best checkpoint on unseen scenes, write figures and images; options: `--help`."""

from omegaconf import DictConfig

from omniocc.runs.script import quiet_libraries, script
from omniocc.train.command import train


@script("train", "the same command goes on")
def main(cfg: DictConfig) -> None:
    """Run the stages of the configuration that are missing."""
    quiet_libraries()
    train(cfg)


if __name__ == "__main__":
    main()
