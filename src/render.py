"""Render the virtual dataset of a preset, read it back, or browse it; see `python src/render.py --help`."""

from omniocc.commands.render import main

if __name__ == "__main__":
    main()
