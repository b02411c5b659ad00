"""Reads an export with flashbax's ``Vault``, as OG-MARL does; see ``reference.py``."""

import json
import sys
from pathlib import Path

here = sys.path.pop(0)  # or this file would be imported in place of the library
import numpy as np  # noqa: E402
from flashbax.vault import Vault  # noqa: E402

sys.path.append(here)
from compare import report  # noqa: E402

exported, reference = Path(sys.argv[1]).resolve(), sys.argv[2]
known = np.load(reference)
vault = Vault(
    vault_name=exported.parent.name,
    vault_uid=exported.name,
    rel_dir=str(exported.parents[1]),
)
state = vault.read()
experience = {key: values for key, values in state.experience.items() if key != "infos"}
sizes = json.loads((exported / "metadata.json").read_text("utf-8"))["sizes"]
names = known["agents"].tolist()
read: dict[str, object] = {"state": state.experience["infos"]["state"][0]}
expected = {"state": known["observations"]}
shared = {"rewards": "rewards", "terminals": "terminals", "truncations": "timeouts"}
for number, name in enumerate(names):
    for key in ("observations", "actions"):
        values = np.asarray(experience[key][0, :, number])
        size = sizes[name][key]
        read[f"{name}/{key}"] = values[:, :size]
        expected[f"{name}/{key}"] = known[f"{name}/{key}"]
        read[f"{name}/{key}, filled"] = values[:, size:]
        expected[f"{name}/{key}, filled"] = np.zeros_like(values[:, size:])
    for key, ours in shared.items():
        read[f"{name}/{key}"] = experience[key][0, :, number]
        expected[f"{name}/{key}"] = known[ours]
report("flashbax", read, expected)
