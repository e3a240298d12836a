"""The forty pictures and what was read off them: `python -m tests.records.contact_sheet`.

Writes the pictures and a contact sheet of their overlays into a folder (default `out/pictures`).
"""

import sys
from pathlib import Path

import jax
import numpy as np
from PIL import Image, ImageDraw
from tests.records.rendered import FITS, PLOTS
from tests.records.test_image import rmse, three

from stepax import StepRecord, identify, trace_image
from stepax._compilation import quick_compilation
from stepax.records.image._overlay import overlay
from stepax.records.image._trace import read_picture


TILE, ACROSS = (620, 470), 5


def sheet(drawn) -> Image.Image:
    """All overlays under their names."""
    rows = -(-len(drawn) // ACROSS)
    picture = Image.new("RGB", (ACROSS * TILE[0], rows * TILE[1]), "white")
    draw = ImageDraw.Draw(picture)
    for place, (name, (path, options, _)) in enumerate(drawn.items()):
        tile = overlay(read_picture(path, options["color"]))
        tile.thumbnail((TILE[0] - 10, TILE[1] - 25))
        x, y = (place % ACROSS) * TILE[0], (place // ACROSS) * TILE[1]
        picture.paste(tile, (x, y + 20))
        draw.text((x + 5, y + 4), name, fill="black")
    return picture


def main() -> None:
    jax.config.update("jax_enable_x64", True)
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else "out/pictures")
    folder.mkdir(parents=True, exist_ok=True)
    drawn = {plot.name: plot.written(folder) for plot in PLOTS}
    sheet(drawn).save(folder / "contact_sheet.png")
    errors, shares, inside = [], [], []
    print("rows, RMSE in % of the axis; picture against data: gain, dead time, sum of lags in % of")
    print("the span, and over their standard errors")
    for plot in PLOTS:
        path, options, _ = drawn[plot.name]
        record = trace_image(path, **options)
        errors.append(100 * rmse(plot, record, drawn))
        method, more = FITS[plot.response]
        with quick_compilation():
            data, _ = three(identify(StepRecord(*plot.data), method, **more))
            read, std = three(identify(record, method, **more))
        shares.append(100 * np.abs(read - data) / [15, 10, 10])
        inside.append((read - data) / std)
        numbers = " ".join(f"{x:6.3f}" for x in shares[-1])
        scores = " ".join(f"{x:5.2f}" for x in inside[-1])
        print(
            f"{plot.name:32}{record.t.size:5}{errors[-1]:7.3f}   {numbers}   {scores}", flush=True
        )
    print(f"RMSE: median {np.median(errors):.3f} %, largest {np.max(errors):.3f} %")
    print("models: medians", *(f"{x:.3f} %" for x in np.median(shares, axis=0)), end=", ")
    print(f"within the 95 % intervals {100 * np.mean(np.abs(inside) < 1.96):.1f} %")


if __name__ == "__main__":
    main()
