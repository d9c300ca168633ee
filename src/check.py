"""Read a dataset back and list all that is wrong with it; see `python src/check.py --help`."""

from omniocc.commands.check import main

if __name__ == "__main__":
    main()
