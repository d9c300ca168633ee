"""Train a model, test its best checkpoint, write figures and images; see `python src/train.py --help`."""

from omniocc.commands.train import main, work  # noqa: F401  `work` is for omniocc.runs.fork_server

if __name__ == "__main__":
    main()
