"""Run records as data frames, for questions that no table answers."""

from typing import Final

import numpy as np
import pandas as pd

from benchmark.constants import HORIZON_STEPS
from benchmark.geometry import Floats
from benchmark.metrics.scores import require_current
from benchmark.protocols import PROTOCOLS, compute_published_values
from benchmark.records.run import RunRecord, collect_outcomes

ROW_FIELDS: Final = ("scene", "sample_token", "index", "status", "place", "speed_m_s")
"""Fields of `benchmark.records.row_schema.SampleRow` that lead the frame; the token's column is ``sample``."""
COLUMNS: Final = ("collision", "l2")
"""Columns of every protocol that it has at each horizon (`benchmark.protocols.contract.COLUMN_MEANINGS`)."""


def samples_frame(record: RunRecord) -> pd.DataFrame:
    """One row a sample; the mean of a number's column is the published rate.

    Args:
        record: A run record.

    Returns:
        Columns ``scene``, ``sample``, ``index``, ``status``, ``place`` and ``speed_m_s`` (null in older records); then
        for each protocol that judged the record ``<protocol> collision <horizon>`` (0 to 1) and ``<protocol> l2
        <horizon>`` (metres) at ``1s``, ``2s`` and ``3s``, each as the protocol averages it. NaN where there is no plan,
        the protocol does not count the sample, or nothing is known of it, at the horizon or at all.

    Raises:
        InputError: If a protocol judged the record in another version than the present one, or is not known here.
    """
    of_rows = list(zip(*(record.columns.values(name) for name in ROW_FIELDS)))
    frame = pd.DataFrame(of_rows, columns=[name.removesuffix("_token") for name in ROW_FIELDS])
    planned = (frame["status"] == "ok").to_numpy()
    columns: dict[str, Floats] = {}
    for name in dict.fromkeys([*PROTOCOLS, *record.run.protocols]):
        if name not in record.run.protocols:
            continue
        require_current(record, name)
        outcomes = collect_outcomes(record.rows, name)
        values = compute_published_values(PROTOCOLS[name], outcomes)
        for column in COLUMNS:
            table = np.full((len(frame), len(HORIZON_STEPS)), np.nan)
            table[planned] = np.where(outcomes.counted[:, None], values[column], np.nan)
            columns |= {f"{name} {column} {horizon}": table[:, place] for place, horizon in enumerate(HORIZON_STEPS)}
    return pd.concat([frame, pd.DataFrame(columns)], axis=1)
