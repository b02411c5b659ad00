"""Reads an export with robomimic's ``SequenceDataset``; see ``reference.py``."""

import sys

here = sys.path.pop(0)  # or this file would be imported in place of the library
import numpy as np  # noqa: E402
from robomimic.utils import file_utils, obs_utils  # noqa: E402
from robomimic.utils.dataset import SequenceDataset  # noqa: E402

sys.path.append(here)
from compare import report  # noqa: E402

exported, reference = sys.argv[1:]
known = np.load(reference)
names = ["state", *known["agents"].tolist()]
obs_utils.initialize_obs_utils_with_obs_specs({"obs": {"low_dim": names}})
dataset = SequenceDataset(
    exported,
    obs_keys=names,
    dataset_keys=("actions", "rewards", "dones"),
    hdf5_cache_mode="low_dim",
)
about = file_utils.get_shape_metadata_from_dataset(exported, all_obs_keys=names)
print(file_utils.get_env_metadata_from_dataset(exported), about["all_shapes"])
rows = [dataset[i] for i in range(len(dataset))]
keys = {"state": ""} | {name: f"{name}/" for name in names[1:]}
report(
    "robomimic",
    {
        **{
            key: [row[key][0] for row in rows]
            for key in ("actions", "rewards", "dones")
        },
        **{f"obs/{name}": [row["obs"][name][0] for row in rows] for name in names},
        **{
            f"next_obs/{name}": [row["next_obs"][name][0] for row in rows]
            for name in names
        },
        "lengths": [dataset._demo_id_to_demo_length[demo] for demo in dataset.demos],
    },
    {
        **{key: known[key] for key in ("actions", "rewards")},
        "dones": known["terminals"],
        **{f"obs/{name}": known[f"{key}observations"] for name, key in keys.items()},
        **{
            f"next_obs/{name}": known[f"{key}next_observations"]
            for name, key in keys.items()
        },
        "lengths": known["lengths"],
    },
)
