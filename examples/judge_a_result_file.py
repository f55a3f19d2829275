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
# # Judge a result file
#
# The repositories of UniAD, VAD, SparseDrive and others dump their plans into files of their own. Those files are
# judged here, by every protocol, without running anybody's code: unpickled under an allow-list, and refused where
# their plans cannot belong to the samples.

# %%
from pathlib import Path

import benchmark

out = Path("challenger-out")
runs = out / "runs"

# %% [markdown]
# ## A file
#
# Here it is made by us, in VAD's format, from the plans of a planner that keeps its speed. Yours comes from
# `tools/test.py` of that repository, on your data.

# %%
settings = benchmark.TownSettings(val_scenes=2, images=False)
town = benchmark.open_data(benchmark.build_town(out / "small-town", settings, workers=1))
record = benchmark.evaluate(town, "val", benchmark.load_planner("constant-velocity"), runs)
file = benchmark.write_results(record, benchmark.recorded_samples(town, "val"), "vad-out", out / "dumped")
print(f"{file}: {file.stat().st_size:,} bytes" if file.is_file() else file)

# %% [markdown]
# ## What is it?
#
# The format is found out. What shows that its plans belong to these samples, what was checked and what the file does
# not hold is said, and stands in the record afterwards.

# %%
opened = benchmark.open_results(file)
planner = benchmark.result_file_factory([opened], town, "val", name="from the file")
print(f"format: {opened.format.name}")
for sentence in planner.sentences:
    print(f"- {sentence}")

# %% [markdown]
# ## Judged
#
# The column `native` is the protocol of the repository that the file comes from; two protocols never share a column.

# %%
judged = benchmark.evaluate(town, "val", planner, runs)
for table in benchmark.run_tables("small town", [judged]):
    print(table.plain())

# %% [markdown]
# The file lost nothing: its verdicts are those of the plans that it was written from.

# %%
for protocol in ("exact", "vad"):
    were, are = (one.summary.protocols[protocol].columns["collision"]["3s"].value for one in (record, judged))
    print(f"{protocol}: {were} as planned, {are} from the file")
    assert were == are

# %% [markdown]
# From a shell: `challenger-bench eval --results FILE --data ROOT --split val`.
