"""Pictures of plots: forty that matplotlib draws of known responses, and what is no plot."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from tests.records.rendered import FITS, PLOTS, Plot, lag, words

import stepax
from stepax import StepRecord, identify, trace_image
from stepax.records.image._box import find_box
from stepax.records.image._overlay import overlay
from stepax.records.image._path import candidates, cheapest, stroke_width
from stepax.records.image._picture import load
from stepax.records.image._trace import read_picture


HEATER = Path(__file__).parents[3] / "shared/data/heater_plot.png"
NAMES = [plot.name for plot in PLOTS]


@pytest.fixture(scope="module")
def drawn(tmp_path_factory):
    """Path, options and edges of each picture by its name."""
    folder = tmp_path_factory.mktemp("plots")
    return {plot.name: plot.written(folder) for plot in PLOTS}


@pytest.fixture(scope="module")
def traced(drawn):
    return {name: trace_image(path, **options) for name, (path, options, _) in drawn.items()}


@pytest.fixture
def picture(drawn):
    """Pixels of the plain plot, its options, and a function that reads what it is made into."""
    path, options, _ = drawn["default"]
    return np.array(Image.open(path)), options


def span(plot, drawn):
    """Values that the height of the axes holds."""
    path, options, edges = drawn[plot.name]
    found = read_picture(path, options["color"])
    marks, values = found.ticks.y, options.get("y_ticks")
    if values is None:
        return options["y_range"][1] - options["y_range"][0]
    return (values[1] - values[0]) * (edges[3] - edges[1]) / (marks[0] - marks[-1])


def rmse(plot, record, drawn):
    """Root mean square error over the rows within the data, as a share of the axis."""
    t, y = (np.asarray(x) for x in (record.t, record.y))
    inside = (t >= 0) & (t <= 10)
    error = (y - np.interp(t, *plot.data))[inside]
    return float(np.sqrt(np.mean(error**2))) / span(plot, drawn)


@pytest.mark.parametrize("plot", PLOTS, ids=NAMES)
def test_rows_are_those_that_were_drawn(plot, traced, drawn):
    record = traced[plot.name]
    assert rmse(plot, record, drawn) <= 0.005
    covered = 0.4 if "markers" in plot.name or "dashed" in plot.name else 0.75
    width = drawn[plot.name][2][2] - drawn[plot.name][2][0]
    assert record.t.size > covered * 0.9 * width
    assert np.all(np.diff(record.t) > 0) and np.all(record.weights > 0)


def test_the_median_picture_is_read_to_a_sixth_of_a_percent(traced, drawn):
    assert np.median([rmse(plot, traced[plot.name], drawn) for plot in PLOTS]) <= 0.0015


@pytest.mark.parametrize("plot", [p for p in PLOTS if "ggplot" not in p.name], ids=lambda p: p.name)
def test_the_box_is_found_to_a_pixel(plot, drawn):
    """Up to what drawing on whole pixels moves the frame, a pixel at most, and its thickness."""
    path, _, edges = drawn[plot.name]
    box = find_box(load(path).pixels)
    ends = 1 + box.line if plot.name == "two spines" else 1.01  # a lone spine ends beyond the axes
    np.testing.assert_array_less(np.abs(np.array(box[:4]) - edges), ends)


# Models


def three(result):
    """Gain, dead time and sum of lags, with their standard errors."""
    model, values = result.model, {}
    for name in result.free:
        values[name] = float(getattr(model, name))
    lags = {
        "fopdt_fit": lambda x: x["T"],
        "sopdt_fit": lambda x: 2 * x["zeta"] / x["omega_n"],
        "hudzovic_fit": lambda x: x["T"] * sum(1 / (1 - k * x.get("r", 0.0)) for k in range(3)),
    }
    kind = {"FOPDT": "fopdt_fit", "SOPDT": "sopdt_fit", "Hudzovic": "hudzovic_fit"}
    total = lags[kind[type(model).__name__]]
    step = {name: 1e-6 * max(abs(x), 0.1) for name, x in values.items()}
    slope = np.array([
        (total(values | {n: values[n] + h}) - total(values | {n: values[n] - h})) / (2 * h)
        for n, h in step.items()
    ])  # fmt: skip
    variance = slope @ np.nan_to_num(np.asarray(result.covariance)) @ slope
    found = [float(model.gain), float(model.delay), total(values)]
    return np.array(found), np.array(
        [float(result.std["gain"]), float(result.std["delay"]), variance**0.5]
    )


def compared(plots, traced):
    """Differences of models from pictures and from data over the spans, and over the errors."""
    shares, errors = [], []
    for plot in plots:
        method, options = FITS[plot.response]
        data, _ = three(identify(StepRecord(*plot.data), method, **options))
        read, std = three(identify(traced[plot.name], method, **options))
        shares.append(np.abs(read - data) / [15, 10, 10])
        errors.append(np.abs(read - data) / std)
    return np.array(shares), np.array(errors)


def test_models_of_pictures_are_those_of_the_data(traced, quick_compilation):
    plots = [p for p in PLOTS if p.response is lag]
    shares, errors = compared(plots, traced)
    assert np.all(np.median(shares, axis=0) < 0.01)
    assert np.mean(errors < 1.96) >= 0.9


@pytest.mark.long
def test_models_of_all_pictures_are_those_of_the_data(traced, quick_compilation):
    shares, errors = compared(PLOTS, traced)
    assert np.all(np.median(shares, axis=0) < 0.01)
    assert np.mean(errors < 1.96) >= 0.9


@pytest.mark.skipif(not HEATER.exists(), reason="the picture is not here")
def test_heater(quick_compilation):
    """The picture behind Murray's section 3.1, whose own import leaves 0.15 to 0.27 degrees."""
    box = find_box(load(HEATER).pixels)
    np.testing.assert_allclose(box[:4], [63, 34, 670, 514], atol=1)
    record = trace_image(HEATER, x_range=(0, 10), y_range=(20, 38))
    for method in ("sani_fit", "hudzovic_fit"):
        result = identify(record, method)
        assert int(result.model.n) == 4 and float(result.rmse) <= 0.10


# Other frames


def grid_alone(axes):
    axes.grid(True)
    axes.spines[:].set_visible(False)
    axes.tick_params(length=0)


def horizontal_lines(axes):
    axes.set(xlim=(0, 10), ylim=(20, 40))
    axes.grid(axis="y")
    axes.spines[["left", "top", "right"]].set_visible(False)
    axes.tick_params(length=0)


def coloured_frame(axes):
    axes.spines[:].set_color("tab:red")


def from_the_corner(axes):
    axes.set(xlim=(0, 10), ylim=(22, 38))


def a_line_at_the_end(axes):
    axes.axhline(37, color="0.4", linestyle="--")


OTHERS = [
    Plot("grid alone", lag, size=(6.4, 4.8), beside=(grid_alone,), ticks=False),
    Plot("horizontal lines", lag, size=(6.4, 4.8), beside=(horizontal_lines,), ticks=False),
    Plot("coloured frame", lag, size=(6.4, 4.8), beside=(coloured_frame,)),
    Plot("from the corner", lag, size=(6.4, 4.8), beside=(from_the_corner,)),
    Plot("a line at its end", lag, size=(6.4, 4.8), beside=(a_line_at_the_end,)),
    Plot("classic", lag, size=(6.4, 4.8), style="classic"),
    Plot("solarized", lag, size=(6.4, 4.8), style="Solarize_Light2"),
    Plot("fivethirtyeight", lag, size=(6.4, 4.8), style="fivethirtyeight"),
    Plot("not smoothed", lag, size=(6.4, 4.8), line={"antialiased": False}),
    Plot("pale grey", lag, size=(6.4, 4.8), line={"color": "0.6"}, beside=(words,)),
    Plot("yellow", lag, size=(6.4, 4.8), line={"color": "gold"}),
]


@pytest.mark.parametrize("size", [1.0, 0.73])
@pytest.mark.parametrize("plot", OTHERS, ids=lambda plot: plot.name)
def test_other_frames_and_screenshots(plot, size, tmp_path):
    """Also made smaller, as a picture on a page is, which blurs every line."""
    path, options, _ = plot.written(tmp_path)
    with Image.open(path) as image:
        smaller = image.resize((int(size * image.width), int(size * image.height)), 2)
    smaller.save(path)
    record = trace_image(path, **options)
    t, y = np.asarray(record.t), np.asarray(record.y)
    inside = (t >= 0) & (t <= 10)
    error = (y - np.interp(t, *plot.data))[inside]
    assert np.sqrt(np.mean(error**2)) < 0.006 * 16.5 and inside.sum() > 0.6 * 496 * size


# Calibration


def test_three_ways_of_calibration_agree(drawn):
    path, options, _ = drawn["ticks inside"]
    found = read_picture(path)
    box = found.box
    by_ticks = trace_image(path, **options)
    edges = {"x_range": (0, 10), "y_range": (20, 45)}
    corners = [((box.left, box.bottom), (0, 20)), ((box.right, box.top), (10, 45))]
    mixed = {"x_ticks": (0, 10), "points": corners}
    for other in (edges, {"points": corners}, mixed):
        record = trace_image(path, **other)
        np.testing.assert_allclose(record.t, by_ticks.t, atol=0.01)
        np.testing.assert_allclose(record.y, by_ticks.y, atol=0.05)


def test_without_calibration_it_says_what_was_found(drawn):
    with pytest.raises(
        ValueError, match=r"6 tick marks on x and 8 on y.*#1f77b4.*For x and y give"
    ):
        trace_image(drawn["default"][0])
    with pytest.raises(ValueError, match="For y give"):
        trace_image(drawn["default"][0], x_ticks=(0, 10))
    with pytest.raises(ValueError, match=r"curves in #.*, #.*Give color"):
        trace_image(drawn["two curves"][0], x_ticks=(0, 10), y_ticks=(0, 10))


WRONG = {
    "reversed": ({"x_range": (10, 0)}, "from a smaller to a larger"),
    "equal": ({"y_ticks": (3, 3)}, "from a smaller to a larger"),
    "not finite": ({"y_range": (0, float("inf"))}, "from a smaller to a larger"),
    "one number": ({"x_range": 3}, "x_range must be two numbers"),
    "twice": ({"x_range": (0, 1), "x_ticks": (0, 1)}, "not both"),
    "one point": ({"points": [((0, 0), (0, 0))]}, "two different places"),
    "upside down": ({"points": [((0, 0), (0, 0)), ((9, 9), (1, 1))]}, "rise to the top"),
    "no points": ({"points": [1, 2]}, "pairs of pixel and value"),
    "no colour": ({"color": "#zz"}, "#rrggbb"),
    "no name": ({"color": 3}, "#rrggbb"),
    "another colour": ({"color": "red"}, "no curve in red; colours of its curves: #1f77b4"),
    "no grey": ({"color": "black"}, "no curve in black"),
    "no box": ({"box": (1, 2, 3)}, "four pixels"),
    "box outside": ({"box": (0, 0, 9000, 10)}, "must lie in the picture"),
    "no time": (
        {"x_range": (0, 10), "y_range": (20, 38), "step_time": "soon"},
        "a number, or None",
    ),
    "late step": ({"x_range": (0, 10), "y_range": (20, 38), "step_time": 30}, "give step_time"),
}


@pytest.mark.parametrize(("options", "sentence"), WRONG.values(), ids=WRONG)
def test_what_cannot_be_used(options, sentence, drawn):
    with pytest.raises((ValueError, TypeError), match=sentence) as raised:
        trace_image(drawn["steep"][0], **options)
    assert "\n" not in str(raised.value)


# Kinds of pictures


def same(record, other):
    np.testing.assert_array_equal(record.t, other.t)
    np.testing.assert_allclose(record.y, other.y, atol=0.01)


@pytest.mark.parametrize("kind", ["palette", "alpha", "transparent", "gif"])
def test_modes(kind, picture, traced, tmp_path):
    pixels, options = picture
    path = tmp_path / ("a.gif" if kind == "gif" else "a.png")
    image = Image.fromarray(pixels)
    if kind == "transparent":
        opaque = 255 - np.where(np.all(pixels == 255, axis=2), 255, 0).astype(np.uint8)
        image = Image.fromarray(np.dstack([pixels, opaque]))
    elif kind == "alpha":
        image = image.convert("RGBA")
    else:
        image = image.quantize(200)
    image.save(path)
    same(trace_image(path, **options), traced["default"])


def test_grey_of_16_bits(drawn, traced, tmp_path):
    path, options, _ = drawn["grey"]
    deep = np.array(Image.open(path)).astype(np.uint16) * 257
    Image.fromarray(deep).save(tmp_path / "deep.png")
    same(trace_image(tmp_path / "deep.png", **options), traced["grey"])


def test_light_on_transparent_ground(drawn, traced, tmp_path):
    """What was drawn light, for slides, is read on a dark ground."""
    path, options, _ = drawn["dark"]
    pixels = np.array(Image.open(path)).astype(float)
    opaque = pixels.max(axis=2, keepdims=True)
    ink = np.rint(255 * pixels / np.maximum(opaque, 1))
    layers = np.concatenate([ink, opaque], axis=2).astype(np.uint8)
    Image.fromarray(layers).save(tmp_path / "slide.png")
    same(trace_image(tmp_path / "slide.png", **options), traced["dark"])


# What is in the way


def test_markers_are_left_out(drawn):
    """No column of the markers themselves is read: each is 8 pixels wide or more."""
    path, options, _ = drawn["markers"]
    plot = PLOTS[NAMES.index("markers")]
    places = plot.data[0][:: plot.line["markevery"]]
    t = np.asarray(trace_image(path, **options).t)
    column = np.median(np.diff(t))
    nearest = np.min(np.abs(t[:, None] - places), axis=0)
    assert np.median(nearest) > 2 * column


def test_gaps_are_left_out(traced):
    """Between dashes there are no rows; the curve goes on behind each gap."""
    t = np.asarray(traced["dashed"].t)
    gaps = np.diff(t) > 2.5 * np.median(np.diff(t))
    assert gaps.sum() > 30 and t[-1] - t[0] > 9.9


@pytest.mark.parametrize("slope", [0.2, 0.375, 1.0])
def test_a_way_goes_straight_through_a_crossing(slope):
    """Two lines of one colour: a way stays on the one that it began with."""
    columns, rows = np.arange(160), np.arange(200)[:, None]
    falling, rising = 100 + slope * (columns - 80), 100 - slope * (columns - 80)
    falling_ink, rising_ink = (np.clip(1.5 - np.abs(rows - y), 0, 1) for y in (falling, rising))
    rising_ink[:, :30] = 0  # so that the other one is longer
    runs = candidates(np.maximum(falling_ink, rising_ink))
    column, place = cheapest(runs, stroke_width(runs))
    apart = np.abs(runs.centre[column, place] - falling[column])
    assert column.size > 150 and np.all(apart[np.abs(column - 80) > 3 / slope] < 0.5)


def test_rows_are_weighed_by_how_certain_they_are(traced):
    """Steep rows weigh less: a column of pixels is uncertain by itself."""
    record = traced["steep"]
    slope = np.abs(np.gradient(record.y, record.t))
    weights = np.asarray(record.weights)
    assert np.median(weights[slope > 0.3 * slope.max()]) < 0.05 * np.median(weights[slope < 0.1])


def test_the_stroke_is_as_certain_as_it_says(traced, drawn):
    """Level rows: over all pictures errors are of the size of the standard deviation."""
    scores = []
    for plot in PLOTS:
        record, last = traced[plot.name], 9.0 if plot.response is not lag else 0.5
        t, y = np.asarray(record.t), np.asarray(record.y)
        level = (t > last) if last == 9.0 else (t > 0) & (t < last)
        if plot.noise == 0 and level.sum() > 5:
            error = np.mean((y - np.interp(t, *plot.data))[level])
            scores.append(error / float(record.details["stroke"]))
    assert len(scores) > 30 and 0.4 < np.sqrt(np.mean(np.square(scores))) < 1.3


# The step


def written(folder, name, draw_more=lambda axes: None, shift=0.0, color=None):
    plot = Plot(name, lambda t: lag(t - shift), size=(6.4, 4.8), beside=(draw_more,), color=color)
    path, options, _ = plot.written(folder)
    return path, options


def test_a_row_stands_at_a_step_that_the_frame_hides(drawn):
    """With limits at the data the frame covers the first columns."""
    path, options, _ = drawn["ticks inside"]
    record = trace_image(path, **options)
    assert record.t[0] == record.step_time == 0
    assert record.weights[0] < 0.01 * np.median(record.weights)
    assert record.y[0] == pytest.approx(22, abs=0.05)


def test_step_where_the_curve_leaves_its_level(tmp_path):
    path, options = written(tmp_path, "level first", shift=2.0)
    record = trace_image(path, **options, step_time=None, step_size=3.0)
    assert float(record.step_time) == pytest.approx(2.8, abs=0.03)
    assert float(record.step_size) == 3
    with pytest.raises(ValueError, match="does not stay level"):
        plot = Plot("never level", lambda t: t / 10, size=(6.4, 4.8))
        path, options, _ = plot.written(tmp_path)
        trace_image(path, **options, step_time=None)


def test_a_drawn_step_is_no_curve_but_its_time(tmp_path):
    def step(axes):
        axes.plot([0, 2, 2, 10], [24, 24, 33, 33], color="tab:orange")

    path, options = written(tmp_path, "with the input", step, shift=2.0)
    record = trace_image(path, **options, step_time=None)
    assert float(record.step_time) == pytest.approx(2.0, abs=0.03)
    assert float(record.y[-1]) == pytest.approx(22 + 15 * lag(8.0), abs=0.05)


# The overlay, time


def test_the_overlay_shows_what_was_read(drawn):
    path, *_ = drawn["default"]
    found = read_picture(path)
    image = np.array(overlay(found)).astype(int)
    zoom = image.shape[1] // found.picture.width
    middle = found.stroke.column.size // 2
    x, y = (int(zoom * (at[middle] + 0.5)) for at in (found.stroke.column, found.stroke.row))
    red, green, blue = image[y, x]
    assert red > 200 and green < 60 and blue < 90
    red, green, blue = image[int(zoom * (found.box.top + 0.5)), image.shape[1] // 2]
    assert green > red + 50


def test_trace_image_writes_the_overlay(drawn, tmp_path):
    path, options, _ = drawn["default"]
    names = {"time": "time (min)", "output": "level (cm)"}
    record = trace_image(path, **options, **names, overlay=tmp_path / "check.png")
    assert record.labels[1:3] == ("time (min)", "level (cm)")
    with Image.open(tmp_path / "check.png") as image:
        assert np.array_equal(np.array(image), np.array(overlay(read_picture(path))))
    with pytest.raises(ValueError, match=r"end in \.png, got '.*check\.jpg'"):
        trace_image(path, **options, overlay=tmp_path / "check.jpg")


def test_it_is_public():
    assert stepax.trace_image is trace_image
