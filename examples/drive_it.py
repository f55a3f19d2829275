# ---
# jupyter:
#   jupytext:
#     text_representation:
#       extension: .py
#       format_name: percent
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # Drive it
#
# In open loop a plan is compared with a recording. Here it is driven: the car goes where the plan says, others follow
# the recording or react, and what is measured is what happens.

# %%
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import benchmark

out = Path("challenger-out")
drives = out / "drives"

# %%
settings = benchmark.TownSettings(val_scenes=2, images=False)
town = benchmark.open_data(benchmark.build_town(out / "small-town", settings, workers=1))
frozen = benchmark.frozen_split("mini-adv-4")
here = tuple(scene.name for scene in frozen.frozen.scenes if scene.source in town.scene_names("val"))
built = benchmark.BuildSettings(out=out / "small-adv", scenes=here)
benchmark.build_frozen(town, frozen, built)
adv = benchmark.open_data(out / "small-adv")

# %% [markdown]
# ## Two planners, the same scenes
#
# Driving begins 3 s before the adversary departs from its recording. It does what the search found, and everybody else
# keeps the distance (`idm`). Cameras are off, since neither of the two looks.

# %%
planned = benchmark.drive_settings("adv")
records = [
    benchmark.drive_split(adv, "adv", benchmark.load_planner(name), drives, planned)
    for name in ("constant-velocity", "idm")
]
for table in benchmark.drive_tables(records):
    print(table.plain())

# %% [markdown]
# ## What happened
#
# One row a drive: every planning instant, every plan, the first contact and whose fault it was.

# %%
for record in records:
    for row in record.rows:
        if row.contact is None:
            print(f"{record.planner} in {row.scene}: no contact")
        else:
            fault = "its fault" if row.contact.at_fault else "not its fault"
            what = f"contact ({row.contact.kind}) after {row.contact.seconds:.1f} s, {fault}"
            print(f"{record.planner} in {row.scene}: {what}")

# %%
figure, axes = plt.subplots(figsize=(8, 3))
for record in records:
    ticks = record.rows[0].ticks
    seconds = (np.array(ticks.time_us) - ticks.time_us[0]) * 1e-6
    axes.plot(seconds, [state[3] for state in ticks.ego], label=record.planner)
axes.set(xlabel="s", ylabel="speed, m/s", title=records[0].rows[0].scene)
axes.legend()
figure.savefig(out / "drive-it.png", dpi=120, bbox_inches="tight")

# %% [markdown]
# ## Others that do not react
#
# With `agents="replay"` the others do what was recorded, and `window="scene"` drives all of each scene. The two never
# share a table.

# %%
as_recorded = benchmark.drive_settings("adv", agents="replay", window="scene")
replayed = benchmark.drive_split(adv, "adv", benchmark.load_planner("constant-velocity"), drives, as_recorded)
print(replayed.directory.parent.name, {name: rate.value for name, rate in list(replayed.summary.columns.items())[:3]})

# %% [markdown]
# From a shell: `challenger-bench drive --split adv --model idm`, and `film --drives` to look at it.
