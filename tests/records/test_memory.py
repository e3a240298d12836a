"""Files in memory are read as those on disk."""

import io
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.io import savemat

from stepax import read_record, trace_image


T = np.arange(0.0, 60.0)
U = 5.0 * (T >= 10)
Y = 20 + U * (1 - np.exp(-np.maximum(T - 12, 0) / 8))


def in_memory(path):
    file = io.BytesIO(path.read_bytes())
    file.name = path.name
    return file


@pytest.mark.parametrize("name", ["log.csv", "log.xlsx", "log.mat"])
def test_tables(tmp_path, name):
    path = tmp_path / name
    frame = pd.DataFrame({"t": T, "u": U, "y": Y})
    if name.endswith("csv"):
        frame.to_csv(path, index=False)
    elif name.endswith("xlsx"):
        frame.to_excel(path, index=False)
    else:
        savemat(path, {"t": T, "u": U, "y": Y})
    expected, found = read_record(path), read_record(in_memory(path))
    assert found.labels == expected.labels
    np.testing.assert_array_equal(found.y, expected.y)


def test_picture():
    path = Path(__file__).parents[2] / "docs" / "heater.png"
    axes = {"x_range": (-20, 420), "y_range": (20, 56)}
    expected, found = trace_image(path, **axes), trace_image(in_memory(path), **axes)
    assert found.labels == expected.labels
    np.testing.assert_array_equal(found.y, expected.y)


def test_without_a_name():
    with pytest.raises(ValueError, match=r"^file is empty\.$"):
        read_record(io.BytesIO(b" \n"))
