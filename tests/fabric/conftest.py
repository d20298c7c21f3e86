"""Whole lines as real processes."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))  # kill_processes.py is a script beside the tests
