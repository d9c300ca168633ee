"""Record scenes in CARLA, or make scenes of the logs of a car; see `python src/record.py --help`."""

from omniocc.commands.record import main

if __name__ == "__main__":
    main()
