"""Folders that tests read from."""

from pathlib import Path

ROOT = Path(__file__).parents[2]
SHARED = ROOT.parent / "shared"
DATA = Path(__file__).parent / "data"
TEST_ROBOTS = Path(__file__).parent / "robots"
