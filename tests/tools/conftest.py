import sys
from pathlib import Path

# tools/ is not installed
sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
