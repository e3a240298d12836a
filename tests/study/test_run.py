"""Running a study: what it computes, the same for any chunk, process and after any accident."""

import errno
import json
import os
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest

from stepax import METHODS, PTn, Study, UniformNoise, random_plants, refine, run_study
from stepax.records._record import StepRecord
from stepax.study import _store
from stepax.study._chunk import _record


pytestmark = pytest.mark.usefixtures("quick_compilation")

SMALL = Study(
    {
        "hudzovic_t10_t50_t90": {"span": 0.2},
        "hudzovic_fit": {"order": "hudzovic_t10_t50_t90", "fixed": ("delay",)},
    },
    orders=[2, 8],
    plants=5,
    noise=[0.0, UniformNoise(0.3)],
    draws=2,
    samples=40,
)


@pytest.fixture(scope="module")
def whole():
    return run_study(SMALL, key=7, chunk=11)


def same(found, expected, rtol=1e-9):
    np.testing.assert_array_equal(found.records, expected.records)
    np.testing.assert_array_equal(found.status, expected.status)
    np.testing.assert_allclose(found.rmse, expected.rmse, rtol=rtol, atol=1e-12)


def test_it_is_what_the_methods_give_one_by_one(whole):
    """Records made again from `random_plants`; LOESS and the fit by the public functions."""
    key, frame = jax.random.key(7), whole.to_frame()
    seen = 0
    for number in (1, 13, 22, 39):
        order, plant, level, draw = SMALL.places(np.array(number))
        n = SMALL.orders[order]
        lags = random_plants(jax.random.fold_in(key, n), 5, n).lags[plant]
        places = [jnp.asarray(int(x)) for x in (order, plant, level, draw)]
        t, clean, raw = _record(SMALL, "threefry2x32", jax.random.key_data(key), *places)
        np.testing.assert_allclose(clean, PTn(lags=lags).step_response(t), atol=1e-14)
        np.testing.assert_allclose(np.ptp(raw - clean), 0.28 * (level == 1), atol=0.03)
        record = StepRecord(t, raw, initial=0.0, final=1.0)
        start = METHODS["hudzovic_t10_t50_t90"](record, span=0.2)
        fit = refine(record, start.model, fixed=("delay",), errors=False)
        rows = frame[(frame.order == n) & (frame.plant == plant) & (frame.draw == draw)]
        rows = rows[rows.noise == SMALL.models[level].level].set_index("method")
        for name, result in (("hudzovic_t10_t50_t90", start), ("hudzovic_fit", fit)):
            if np.isnan(rows.rmse[name]):
                continue
            error = np.sqrt(np.mean((result.model.step_response(t) - clean) ** 2))
            np.testing.assert_allclose(rows.rmse[name], error, rtol=1e-7, atol=1e-11)
            seen += 1
    assert seen >= 6


@pytest.mark.parametrize("chunk", [40, pytest.param(7, marks=pytest.mark.long)])
def test_any_chunk(whole, chunk):
    same(run_study(SMALL, key=7, chunk=chunk), whole)


def test_another_key_is_another_study(whole):
    other = run_study(SMALL, key=jax.random.key(8), chunk=11)
    assert not np.allclose(other.rmse, whole.rmse, equal_nan=True)


def test_the_table(whole):
    frame = whole.to_frame()
    assert len(frame) == len(whole) == 2 * 40
    assert set(frame.order) == {2, 8} and set(frame.noise) == {0.0, 0.3}
    assert set(frame.noise_model) == {"GaussianNoise", "UniformNoise"}
    counts = frame.groupby(["order", "plant", "noise", "draw", "method"], observed=True).size()
    assert (counts == 1).all() and len(counts) == 80
    assert (
        frame.rmse.isna() == frame.status.isin(["levels_not_crossed", "beyond_last_order"])
    ).all()
    repr(whole)


def test_summary_is_pandas(whole):
    frame = whole.to_frame()
    table = whole.summary(by=("method", "noise"), quantiles=(0.25, 0.5)).set_index(
        ["method", "noise"]
    )
    ranked = frame.assign(rmse=frame.rmse.fillna(np.inf)).groupby(
        ["method", "noise"], observed=True
    )
    for level, row in table[table.refused < 0.5].iterrows():
        np.testing.assert_allclose(row["q50"], ranked.rmse.median()[level])
        part = frame[(frame.method == level[0]) & (frame.noise == level[1])]
        np.testing.assert_allclose(row["mean"], part.rmse.mean())
        np.testing.assert_allclose(row["rms"], np.sqrt((part.rmse**2).mean()))
        np.testing.assert_allclose(row["refused"], part.rmse.isna().mean())
        np.testing.assert_allclose(row["successful"], (part.status == "successful").mean())
        assert row["median_low"] <= row["q50"] <= row["median_high"]
        assert row["count"] == 20
    with pytest.raises(ValueError, match="no column"):
        whole.summary(by=("colour",))
    assert len(whole.summary(by=(), bootstrap=0)) == 1


def test_bootstrap_interval_has_the_width_of_the_medians_error():
    """Of n normal errors the median has standard error 1.2533 sigma/sqrt(n)."""
    from stepax.study._summary import _numbers

    draw = np.random.default_rng(1)
    widths = []
    for _ in range(40):
        row = _numbers(5 + draw.standard_normal(400), np.arange(400), (0.5,), 400)
        widths.append(row["median_high"] - row["median_low"])
    np.testing.assert_allclose(np.mean(widths), 2 * 1.96 * 1.2533 / 20, rtol=0.1)
    # rows of one plant are one piece of evidence, however often they are repeated
    errors = 5 + draw.standard_normal(400)
    one = _numbers(errors, np.arange(400), (0.5,), 400)
    many = _numbers(np.repeat(errors, 5), np.repeat(np.arange(400), 5), (0.5,), 400)
    np.testing.assert_allclose(many["median_high"], one["median_high"], atol=0.03)


def test_picture(whole, tmp_path):
    figure = whole.plot()
    figure.savefig(tmp_path / "study.png")
    assert figure._repr_png_()[1:4] == b"PNG"  # a notebook shows it
    low, high = figure.axes[0].get_ylim()
    assert 1e-6 < low < high  # what is exact without noise lies below


def test_a_refused_start_is_a_refused_fit(whole):
    lost = np.isnan(whole.rmse)
    assert lost[:, 0].any() and not lost.all()
    np.testing.assert_array_equal(lost[:, 1], lost[:, 0])
    np.testing.assert_array_equal(whole.status[lost[:, 0], 1], whole.status[lost[:, 0], 0])


# The folder


def test_a_store_holds_the_table(whole, tmp_path):
    pytest.importorskip("pyarrow")
    found = run_study(SMALL, key=7, chunk=11, store=tmp_path / "a")
    same(found, whole, 0)
    frame = pd.read_parquet(tmp_path / "a")
    pd.testing.assert_frame_equal(frame, found.to_frame())
    names = sorted(path.name for path in (tmp_path / "a").iterdir())
    assert names == ["_study.json", *(f"chunk-{k:07d}.parquet" for k in range(4))]
    assert {"hash", "versions", "study"} <= set(
        json.loads((tmp_path / "a/_study.json").read_text())
    )


def test_a_store_without_pyarrow(whole, tmp_path, monkeypatch):
    monkeypatch.setattr(_store, "find_spec", lambda name: None)
    same(run_study(SMALL, key=7, chunk=11, store=tmp_path), whole, 0)
    (tmp_path / "chunk-0000001.npz").unlink()
    same(run_study(SMALL, key=7, store=tmp_path), whole, 0)
    with np.load(tmp_path / "chunk-0000000.npz") as file:
        assert file["rmse"].size == 22 and file["method_names"][0] == "hudzovic_t10_t50_t90"


def test_what_is_missing_is_computed(whole, tmp_path):
    part = run_study(SMALL, key=7, chunk=11, store=tmp_path, chunks=slice(1, None, 2))
    assert part.records.size == 11 + 7 and not part.complete
    files = sorted(tmp_path.glob("chunk*"))
    before = [path.stat().st_mtime_ns for path in files]
    same(run_study(SMALL, key=7, store=tmp_path), whole, 0)  # the chunk is the store's
    assert [path.stat().st_mtime_ns for path in files] == before
    with pytest.raises(ValueError, match="chunks of 11"):
        run_study(SMALL, key=7, chunk=5, store=tmp_path)


def test_half_a_file_is_computed_again(whole, tmp_path):
    run_study(SMALL, key=7, chunk=11, store=tmp_path)
    files = sorted(tmp_path.glob("chunk*"))
    files[1].write_bytes(files[1].read_bytes()[:200])
    files[2].write_bytes(files[3].read_bytes())  # whole, and another's
    with pytest.warns(UserWarning, match="computed again") as said:
        same(run_study(SMALL, key=7, store=tmp_path), whole, 0)
    assert len(said) == 2
    same(run_study(SMALL, key=7, store=tmp_path), whole, 0)


def test_another_study_is_refused(whole, tmp_path):
    run_study(SMALL, key=7, chunk=11, store=tmp_path, chunks=slice(0, 1))
    other = Study(SMALL.methods, orders=[2, 8], plants=6, noise=SMALL.noise, draws=2, samples=40)
    with pytest.raises(ValueError, match="another study: plants differ"):
        run_study(other, key=7, store=tmp_path)
    with pytest.raises(ValueError, match="another study: key differ"):
        run_study(SMALL, key=8, store=tmp_path)
    (tmp_path / "_study.json").write_text("{")
    with pytest.raises(ValueError, match="damaged"):
        run_study(SMALL, key=7, store=tmp_path)
    (tmp_path / "_study.json").unlink()
    with pytest.raises(ValueError, match="no folder of a study"):
        run_study(SMALL, key=7, store=tmp_path)


def test_a_full_disk(whole, tmp_path, monkeypatch):
    real, calls = _store.Store._save, []

    def full(self, path, columns):
        calls.append(path)
        if len(calls) == 3:
            path.write_bytes(b"half")
            raise OSError(errno.ENOSPC, "No space left on device")
        real(self, path, columns)

    monkeypatch.setattr(_store.Store, "_save", full)
    with pytest.raises(OSError, match=r"no space is left.*What is there stays good"):
        run_study(SMALL, key=7, chunk=11, store=tmp_path)
    assert sorted(p.name[:13] for p in tmp_path.iterdir())[1:] == ["chunk-0000000", "chunk-0000001"]
    monkeypatch.setattr(_store.Store, "_save", real)
    same(run_study(SMALL, key=7, store=tmp_path), whole, 0)


def test_a_folder_that_cannot_be_written(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(OSError, match="cannot hold a study"):
        run_study(SMALL, store=tmp_path / "file" / "below")
    tmp_path.chmod(0o500)
    if os.access(tmp_path, os.W_OK):
        pytest.skip("this user may write anywhere")
    with pytest.raises(PermissionError, match="cannot hold a study"):
        run_study(SMALL, store=tmp_path / "new")


def test_wrong_arguments():
    with pytest.raises(TypeError, match="key must be"):
        run_study(SMALL, key="seven")
    with pytest.raises(ValueError, match="chunk must be"):
        run_study(SMALL, chunk=0)


# Other processes


@pytest.mark.long
def test_threads(whole, tmp_path):
    with ThreadPoolExecutor(2) as pool:
        same(run_study(SMALL, key=7, chunk=11, executor=pool), whole)
        same(run_study(SMALL, key=7, chunk=11, store=tmp_path, executor=pool), whole)


PROCESS = """
import os, sys, jax
jax.config.update("jax_enable_x64", True)
jax.config.update("jax_disable_most_optimizations", True)
from stepax._compilation import quick_compilation
from stepax import run_study
from stepax.study import _store
from tests.study.test_run import SMALL
if __name__ == "__main__":
    folder, killed = sys.argv[1], len(sys.argv) > 2
    real = _store.Store._save
    def save(self, path, columns):
        real(self, path, columns)
        if killed and "0000002" in path.name:
            print("ready", flush=True)
            import time; time.sleep(60)  # half way: the file is not in its place yet
    _store.Store._save = save
    with quick_compilation():
        run_study(SMALL, key=7, chunk=11, store=folder)
"""


@pytest.mark.long
def test_killed_in_the_middle_and_resumed(whole, tmp_path):
    command = [sys.executable, "-c", PROCESS, tmp_path]
    with subprocess.Popen([*command, "killed"], stdout=subprocess.PIPE) as killed:
        assert killed.stdout is not None and killed.stdout.readline().strip() == b"ready"
        killed.send_signal(signal.SIGKILL)
    assert len(list(tmp_path.glob("chunk*"))) == 2 and len(list(tmp_path.glob(".chunk*"))) == 1
    subprocess.run(command, check=True)
    same(run_study(SMALL, key=7, store=tmp_path), whole)


@pytest.mark.long
def test_two_processes_on_one_folder(whole, tmp_path):
    both = [subprocess.Popen([sys.executable, "-c", PROCESS, tmp_path]) for _ in range(2)]
    assert [process.wait() for process in both] == [0, 0]
    same(run_study(SMALL, key=7, store=tmp_path), whole)


@pytest.mark.long
@pytest.mark.filterwarnings("ignore")
def test_a_dask_cluster_of_which_a_worker_is_killed(whole, tmp_path):
    distributed = pytest.importorskip("distributed")
    settings = {"n_workers": 2, "threads_per_worker": 1, "dashboard_address": None}
    with (
        distributed.LocalCluster(**settings, local_directory=tmp_path) as cluster,
        distributed.Client(cluster) as client,
    ):
        victim = next(iter(client.run(os.getpid).values()))
        with ThreadPoolExecutor(1) as pool:
            dask = client.get_executor()
            run = pool.submit(run_study, SMALL, key=7, chunk=5, store=tmp_path / "s", executor=dask)
            while not list((tmp_path / "s").glob("chunk*")):  # in the middle: some are there
                assert not run.done()
                time.sleep(0.05)
            os.kill(victim, signal.SIGKILL)
            same(run.result(timeout=300), whole, 1e-9)
