"""Reads the metadata of a folder for the Hub with mlcroissant, and checks its files.

PYTHON_WITH_MLCROISSANT tools/read_back/croissant.py FOLDER
"""

import hashlib
import sys
from importlib.metadata import version
from pathlib import Path

import mlcroissant

folder = Path(sys.argv[1])
metadata = mlcroissant.Dataset(jsonld=str(folder / "croissant.json")).metadata
files = {item.content_url: item.sha256 for item in metadata.distribution}
wrong = [
    name
    for name, digest in files.items()
    if hashlib.sha256((folder / name).read_bytes()).hexdigest() != digest
]
print(metadata.ctx.issues.report())
print(f"mlcroissant {version('mlcroissant')}: {len(files)} files, {len(wrong)} differ")
sys.exit(bool(wrong))
