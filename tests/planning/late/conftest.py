import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))  # fields.py, of all tests of planning
