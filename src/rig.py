"""Begin a rig file, or draw and check one; see `python src/rig.py --help`."""

from omniocc.commands.rig import main

if __name__ == "__main__":
    main()
