"""Predict ranges or voxels from your own images, or what a benchmark takes; see `python src/predict.py --help`."""

from omniocc.commands.predict import main

if __name__ == "__main__":
    main()
