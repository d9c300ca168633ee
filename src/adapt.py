"""Train the weights in the package further for your own cameras; see `python src/adapt.py --help`."""

from omniocc.commands.adapt import main

if __name__ == "__main__":
    main()
