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
# # A first look
#
# A small town that challenger-bench draws itself, and what adversaries do in it. Nothing is downloaded; the first run
# builds the town (some seconds), later ones open it.

# %%
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import benchmark

out = Path("challenger-out")

# %% [markdown]
# ## The town
#
# Two scenes of twenty seconds, in nuScenes format: the unmodified nuscenes-devkit opens this folder, and so does
# `benchmark.open_data` any other nuScenes-format folder of yours. Without pictures here, which nothing below looks at;
# `frames="keyframes"` in place of `images=False` draws six cameras.

# %%
settings = benchmark.TownSettings(val_scenes=2, images=False)
town = benchmark.open_data(benchmark.build_town(out / "small-town", settings, workers=1))
for name in town.scene_names("val"):
    scene = town.scene(name)
    print(f"{name}: {scene.description}; {len(scene.agents.ids)} road users, {len(scene.keyframes)} samples")

# %% [markdown]
# ## Adversaries
#
# `mini-adv-4` comes with the package: for each scene, the track of one vehicle that a search made dangerous. It is
# rebuilt here without a search, for the two scenes that this town has.

# %%
frozen = benchmark.frozen_split("mini-adv-4")
here = tuple(scene.name for scene in frozen.frozen.scenes if scene.source in town.scene_names("val"))
built = benchmark.BuildSettings(out=out / "small-adv", scenes=here)
benchmark.build_frozen(town, frozen, built)
adv = benchmark.open_data(out / "small-adv")
facts = adv.scene_facts(adv.scene_names("adv"))
for name, fact in facts.items():
    print(f"{name}: {fact.manoeuvre}, made from {fact.source}")

# %% [markdown]
# ## One of them from above
#
# All arrays are metres, radians and seconds; where an agent is not there, a mask says so.

# %%
scene = adv.scene(adv.scene_names("adv")[0])
adversary = scene.agents.ids.index(scene.adversaries[0])
figure, axes = plt.subplots(figsize=(8, 4))
for agent in range(len(scene.agents.ids)):
    there = scene.agents.valid[agent]
    way = scene.agents.position[agent, there, :2]
    axes.plot(*way.T, color="tab:orange" if agent == adversary else "lightgrey", zorder=2 if agent == adversary else 1)
axes.plot(*scene.ego.position[:, :2].T, color="tab:green", zorder=3)
axes.set(aspect="equal", xlabel="x, m", ylabel="y, m", title=f"{scene.name}: ego green, adversary orange")
figure.savefig(out / "first-look.png", dpi=120, bbox_inches="tight")

# %% [markdown]
# How close do the two come? Between centres, so a car's length is about "touching".

# %%
distance = np.hypot(*(scene.agents.position[adversary, :, :2] - scene.ego.position[:, :2]).T)
closest = int(np.where(scene.agents.valid[adversary], distance, np.inf).argmin())
seconds = (scene.timestamps_us[closest] - scene.timestamps_us[0]) * 1e-6
print(f"closest after {seconds:.1f} s: {distance[closest]:.1f} m between centres")

# %% [markdown]
# Next: `my_planner.py` lets a planner of your own drive here.
