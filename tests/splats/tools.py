"""What the scripts beside this one share."""

import subprocess
import sys
from pathlib import Path


def run(*words: str | Path) -> None:
    done = subprocess.run(words, capture_output=True, text=True)
    if done.returncode != 0:
        sys.exit(f"{' '.join(map(str, words))}: {done.stderr}")
