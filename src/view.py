"""Look at scenes and predictions, or follow runs; see `python src/view.py --help`."""

from omniocc.commands.view import main

if __name__ == "__main__":
    main()
