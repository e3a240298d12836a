"""Tables of named columns, from a text table, an Excel or MAT file, or a DataFrame; host code.

What is wrong with a file is said in one sentence. pandas and scipy.io are imported where a file is
read: they would make `import stepax` a quarter slower.
"""

import importlib
import io
import re
from collections.abc import Sequence
from io import BufferedIOBase
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ._text import heading, text_columns


if TYPE_CHECKING:
    import pandas as pd

TIME_NAME = re.compile(r"^t(?![A-Za-z0-9])|(?i:(?<![a-z])(time|zeit|tiempo|tempo|čas|date|datum))")


class Table(NamedTuple):
    """Named columns; messages count its rows as `word` (line or row) and `numbers`."""

    file: str
    names: list[str]
    columns: "list[pd.Series]"
    word: str
    numbers: Sequence[int]

    @property
    def source(self) -> str:
        """Name of the file, or what else was read."""
        return self.file or "DataFrame"

    def place(self, row: int) -> str:
        """Where a row is."""
        return f"in {self.word} {self.numbers[row]}"


# Sources


def frame_table(frame: "pd.DataFrame | pd.Series") -> Table:
    """Columns of a DataFrame, its index among them if it is named time or is no plain number.

    The index of a Series is its time.
    """
    import pandas as pd

    index = frame.index
    if isinstance(frame, pd.Series):
        values = frame.to_numpy()
        name = "y" if frame.name is None else str(frame.name)
        columns = [index.to_series().reset_index(drop=True), pd.Series(values)]
        names = [str(index.name or "time"), name]
        return Table("", names, columns, "row", range(1, len(frame) + 1))
    if index.dtype.kind not in "iuO" or TIME_NAME.search(str(index.name)):
        frame = frame.reset_index()
    columns = [frame.iloc[:, i] for i in range(frame.shape[1])]
    names = [str(name).strip() for name in frame.columns]
    return Table("", names, columns, "row", range(1, len(frame) + 1))


def opened(source: Any) -> Path | BufferedIOBase:
    """A path, or a binary file that is open, such as one in memory, as it is."""
    return source if hasattr(source, "read") else Path(source)


def file_name(source: Path | BufferedIOBase) -> str:
    """Name of a file, without its folder; of one in memory its `name`, if it has any."""
    return Path(str(getattr(source, "name", "file"))).name


def file_content(path: Path | BufferedIOBase) -> bytes:
    """Bytes of a file that is not empty."""
    try:
        content = path.read_bytes() if isinstance(path, Path) else path.read()
    except FileNotFoundError:
        raise FileNotFoundError(f"There is no file {path}.") from None
    except OSError as error:
        raise OSError(f"{path} cannot be read: {error.strerror}.") from None
    if not content.strip():
        raise ValueError(f"{file_name(path)} is empty.")
    return content


def file_table(path: Path | BufferedIOBase) -> Table:
    """Columns of a file, whose kind its content tells."""
    content, name = file_content(path), file_name(path)
    if name.lower().endswith(".mat") or content.startswith(b"MATLAB"):
        return _mat_table(name, content)
    if content.startswith(b"PK\x03\x04"):  # an archive, as an Excel file is one
        return _excel_table(name, content)
    if content.startswith(b"\xd0\xcf\x11\xe0"):
        raise ValueError(f"{name} is an Excel file of before 2007: save it as .xlsx or CSV.")
    names, columns, numbers = text_columns(name, content)
    return Table(name, names, columns, "line", numbers)


def _mat_table(source: str, content: bytes) -> Table:
    """Vectors of a MAT file."""
    import pandas as pd

    try:
        variables = _mat_variables(content)
    except ImportError:
        raise ImportError(
            f"{source} is a MAT file of version 7.3: pip install h5py, or save it with -v7."
        ) from None
    except Exception:  # scipy has many for a damaged file
        raise ValueError(f"{source} is damaged, or not a MAT file.") from None
    vectors = {
        name: pd.Series(np.ravel(value))
        for name, value in variables.items()
        if isinstance(value, np.ndarray) and value.dtype.kind in "biufc" and name[0] != "_"
        if value.size > 1 and value.size == max(value.shape)
    }
    rows = range(1, 1 + max([column.size for column in vectors.values()], default=0))
    return Table(source, list(vectors), list(vectors.values()), "row", rows)


def _mat_variables(content: bytes) -> dict[str, Any]:
    """Variables of a MAT file of any version."""
    from scipy.io import loadmat

    try:
        return loadmat(io.BytesIO(content))
    except NotImplementedError:  # version 7.3 is HDF5
        with importlib.import_module("h5py").File(io.BytesIO(content)) as file:
            return {name: np.asarray(v) for name, v in file.items() if hasattr(v, "shape")}


def _excel_table(source: str, content: bytes) -> Table:
    """Columns of the first sheet of an Excel file that holds two columns with numbers or more."""
    import pandas as pd

    try:
        sheets = pd.read_excel(io.BytesIO(content), sheet_name=None, header=None, engine="openpyxl")
    except ImportError:
        raise ImportError(
            f'{source} is an Excel file: pip install "stepax[excel]", or save it as CSV.'
        ) from None
    except Exception:  # openpyxl has many for a damaged file, zipfile more
        raise ValueError(f"{source} is damaged, or no Excel file.") from None
    filled = {name: cells.dropna(axis=1, how="all") for name, cells in sheets.items()}
    usable = {name: cells for name, cells in filled.items() if cells.shape[1] > 1}
    if not usable:
        raise ValueError(f"{source} has no sheet with columns for time and output.")
    name, cells = next(iter(usable.items()))
    cells = cells.dropna(how="all")
    top = [["" if pd.isna(x) else str(x).strip() for x in row] for row in cells[:100].to_numpy()]
    begin, names = heading(top, cells.shape[1])
    names = names or [""] * cells.shape[1]
    columns = [cells.iloc[begin:, i].infer_objects() for i in range(cells.shape[1])]
    names = [name or str(i) for i, name in enumerate(names, 1)]
    file = source if len(usable) == 1 else f"{source}, sheet {name}"
    return Table(file, names, columns, "row", (cells.index[begin:] + 1).tolist())
