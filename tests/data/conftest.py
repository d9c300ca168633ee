import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))  # render processes import fake_scene by name
