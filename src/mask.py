"""Mask the pixels in which a rig's cameras see their own car; see `python src/mask.py --help`."""

from omniocc.commands.mask import main

if __name__ == "__main__":
    main()
