"""Damaged files through the real readers: `python -m tests.fuzz --count 20000`."""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parents[1]))  # other helpers of the tests
