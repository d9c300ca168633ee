"""Export a trained network for one rig as a file; see `python src/export.py --help`."""

from omniocc.commands.export import main

if __name__ == "__main__":
    main()
