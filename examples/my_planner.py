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
# # My planner
#
# A planner in a dozen lines, how often it collides on ordinary and on adversarial scenes, and the samples on which it
# does. It stands beside two planners that everybody knows.

# %%
from pathlib import Path

import numpy as np

import benchmark

out = Path("challenger-out")
runs = out / "runs"

# %% [markdown]
# ## Scenes
#
# The small town of `first_look.py` and its adversaries; what is there already is opened. Another data set of yours is
# `benchmark.open_data(Path("/data/nuscenes"))`.

# %%
settings = benchmark.TownSettings(val_scenes=2, images=False)
town = benchmark.open_data(benchmark.build_town(out / "small-town", settings, workers=1))
frozen = benchmark.frozen_split("mini-adv-4")
here = tuple(scene.name for scene in frozen.frozen.scenes if scene.source in town.scene_names("val"))
built = benchmark.BuildSettings(out=out / "small-adv", scenes=here)
benchmark.build_frozen(town, frozen, built)
adv = benchmark.open_data(out / "small-adv")


# %% [markdown]
# ## The planner
#
# It has a name, forgets with `reset` and plans with `plan`: six points, half a second apart, in its own frame (x
# forward, y left). It sees what `benchmark.Observation` holds and nothing of the future.


# %%
class SpeedingUp:
    """Straight ahead, faster and faster."""

    name = "speeding-up"

    def reset(self, scene: benchmark.SceneInfo) -> None:
        """Nothing to forget."""

    def plan(self, observation: benchmark.Observation) -> benchmark.Plan:
        """Accelerate with 1 m/s^2."""
        speed = np.linalg.norm(observation.ego.velocity)
        time = np.arange(1, 7) * 0.5
        ahead = speed * time + 0.5 * time**2
        return benchmark.Plan(np.column_stack([ahead, np.zeros(6)]), benchmark.PlanFrame.EGO)


# %% [markdown]
# ## Evaluated
#
# Each run is a folder of records below `challenger-out/runs`; the same line again reads it and plans nothing. Planners
# that raise are recorded as failed on that sample, never as a zero.

# %%
records = []
for data, split in ((town, "val"), (adv, "adv")):
    for planner in (SpeedingUp(), benchmark.load_planner("constant-velocity"), benchmark.load_planner("idm")):
        records.append(benchmark.evaluate(data, split, planner, runs))
for table in benchmark.run_tables("small town", records):
    print(table.plain())

# %% [markdown]
# ## Sample by sample
#
# One row a sample; the mean of a column is the rate of that protocol and horizon.

# %%
mine = records[3]
samples = benchmark.samples_frame(mine)
hit = samples[samples["exact collision 3s"] == 1]
print(f"{mine.planner} on {mine.run.split}: {len(hit)} of {len(samples)} samples collide within 3 s")
print(hit[["scene", "index", "speed_m_s"]].head().to_string(index=False))

# %% [markdown]
# The same from a shell, for a planner in a module: `challenger-bench eval --model my_planner:SpeedingUp --split adv`.
