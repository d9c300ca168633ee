"""Test a checkpoint again, find what breaks it, or score predictions; see `python src/evaluate.py --help`."""

from omniocc.commands.evaluate import main

if __name__ == "__main__":
    main()
