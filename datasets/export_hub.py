"""Export as a folder for the Hugging Face Hub: data as stored, card, licence, sums."""

import hashlib
import json
import re
from collections.abc import Collection, Mapping
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

from marl_mm.datasets import shipped
from marl_mm.datasets.card import SUMS, card_markdown, kept_card
from marl_mm.datasets.dataset import Dataset
from marl_mm.datasets.export import DATASET_FORMS, DatasetForm
from marl_mm.datasets.hdf5 import FILE
from marl_mm.datasets.named import RECORD, name_of
from marl_mm.errors import DatasetError
from marl_mm.files import write_json

_EDITED = "LICENSE", "README.md", "croissant.json"
"""Files that a licence comes into, if the data are not ours."""

_TYPES = {
    ".hdf5": "application/x-hdf5",
    ".json": "application/json",
    ".md": "text/markdown",
    ".png": "image/png",
    "": "text/plain",
}
"""Media types by a file's ending."""

_NOT_OURS = """No licence is stated yet.

These data come from somebody who used marl_mm, and only they can license them. To
publish: put the licence here, and its name into README.md and croissant.json.
"""

_READ = """
## Read it

Download the folder, and check it: `sha256sum -c SHA256SUMS`.

```python
import marl_mm

data = marl_mm.load_dataset("./FOLDER")  # or minari.MinariDataset("FOLDER/data")
```
"""


def _hub(dataset: Dataset, path: Path) -> None:
    from marl_mm.datasets.card_figure import draw_card  # matplotlib takes a second

    values = kept_card(dataset)
    (path / "data").mkdir()
    for name in (FILE, "metadata.json"):
        data = (dataset.location.data / name).read_bytes()
        if name == FILE and hashlib.sha256(data).hexdigest() != values["data_sha256"]:
            raise DatasetError(
                f"{dataset.location.folder} was replaced since it was loaded: load it "
                "again"
            )
        (path / "data" / name).write_bytes(data)
    draw_card(dataset.arrays, values, path / "card.png")
    ours = _is_ours(dataset, values)
    (path / "LICENSE").write_text(_licence() if ours else _NOT_OURS, "utf-8")
    front = "\n".join(f"{key}: {json.dumps(v)}" for key, v in _front(values, ours))
    page = f"---\n{front}\n---\n\n{card_markdown(values)}{_READ}"
    (path / "README.md").write_text(page, "utf-8")
    edited = () if ours else _EDITED
    croissant = _croissant(dataset, values, ours, _sums(path, edited))
    write_json(path / "croissant.json", croissant)
    lines = [f"{digest}  {name}\n" for name, digest in _sums(path, edited).items()]
    (path / SUMS).write_text("".join(lines), "utf-8")


def _is_ours(dataset: Dataset, values: Mapping[str, Any]) -> bool:
    """Whether these are the package's data, and not only called like them."""
    if values["id"] in shipped.IDS:
        own, theirs = dataset.arrays, shipped.shipped_arrays(values["id"])
        pairs = (own.states, theirs.states), (own.actions, theirs.actions)
        return all(np.array_equal(*pair) for pair in pairs)
    record = json.loads(RECORD.read_text("utf-8")).get(name_of(values["id"]), {})
    digest = values["data_sha256"]
    return digest is not None and bool(record.get("data_sha256") == digest)


def _licence() -> str:
    """The package's licence, of a clone or an installation."""
    beside = Path(__file__).resolve().parents[1] / "LICENSE"
    if beside.exists():
        return beside.read_text("utf-8")
    return metadata.distribution("marl-mm").read_text("licenses/LICENSE") or "MIT\n"


def _front(values: Mapping[str, Any], ours: bool) -> list[tuple[str, Any]]:
    """What the Hub reads at the top of the card."""
    digits = len(str(values["steps"])) - 1
    sizes = ("n<1K", "1K<n<10K", "10K<n<100K", "100K<n<1M", "1M<n<10M", "10M<n<100M")
    licence: dict[str, Any] = {"license": "mit"}
    if not ours:
        link = {"license_name": "not-stated", "license_link": "LICENSE"}
        licence = {"license": "other", **link}
    tags = ["offline-reinforcement-learning", "multi-agent", "minari", "marl_mm"]
    return [
        *licence.items(),
        ("pretty_name", values["id"]),
        ("task_categories", ["reinforcement-learning", "robotics"]),
        ("tags", tags),
        ("size_categories", [sizes[min(max(digits - 2, 0), len(sizes) - 1)]]),
    ]


def _sums(path: Path, edited: Collection[str]) -> dict[str, str]:
    """SHA-256 of the files in a folder, in hex digits, by path; of edited ones none."""
    every = (file for file in path.rglob("*") if file.is_file())
    files = sorted(file for file in every if file.name not in edited)
    return {
        file.relative_to(path).as_posix(): hashlib.sha256(file.read_bytes()).hexdigest()
        for file in files
    }


def _croissant(
    dataset: Dataset, values: Mapping[str, Any], ours: bool, sums: Mapping[str, str]
) -> dict[str, Any]:
    """Metadata of version 1.0 of Croissant, as JSON-LD.

    Croissant cannot address arrays in HDF5, so there are no record sets: entries of
    states and actions, with their units, are variables measured.
    """
    version = re.search(r"-v(\d+)$", values["id"])
    layout = dataset.arrays.layout
    return {
        "@context": {
            "@language": "en",
            "@vocab": "https://schema.org/",
            "sc": "https://schema.org/",
            "cr": "http://mlcommons.org/croissant/",
            "dct": "http://purl.org/dc/terms/",
            "conformsTo": "dct:conformsTo",
        },
        "@type": "sc:Dataset",
        "conformsTo": "http://mlcommons.org/croissant/1.0",
        "name": values["id"].replace("/", "-"),
        "description": f"{values['steps']} steps in {values['episodes']} episodes of "
        f"{values['task']} by {values['collector']}, for offline multi-agent "
        "reinforcement learning.",
        **({"license": "https://spdx.org/licenses/MIT.html"} if ours else {}),
        "version": f"{version[1] if version else 0}.0.0",
        "variableMeasured": [
            {
                "@type": "sc:PropertyValue",
                "name": f"{part}.{entry.name}",
                "unitText": entry.unit,
            }
            for part, entries in (("state", layout.state), ("action", layout.action))
            for entry in entries
        ],
        "distribution": [
            {
                "@type": "cr:FileObject",
                "@id": name,
                "name": name,
                "contentUrl": name,
                "encodingFormat": _TYPES[Path(name).suffix],
                "sha256": digest,
            }
            for name, digest in sums.items()
        ],
    }


DATASET_FORMS.add(
    "hub",
    DatasetForm(
        about="Folder for the Hugging Face Hub: data, card, licence, Croissant, sums.",
        write=_hub,
        mark=(SUMS, f"  data/{FILE}\n"),
        holds=(f"data/{FILE}", "data/metadata.json", *_EDITED, "card.png", SUMS),
    ),
)
