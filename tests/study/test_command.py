"""The command `stepax study`."""

import contextlib
import signal
import subprocess
import sys
import time

import pytest

from stepax._cli import run


ASKED = ["study", "--methods", "smith_1972", "--orders", "2", "--plants", "3", "--samples", "40"]


@pytest.mark.usefixtures("quick_compilation")
def test_a_study_in_a_folder(tmp_path, capsys):
    out = ["--noise", "0,0.1", "--out", str(tmp_path / "s")]
    assert run([*ASKED, *out, "--chunk", "2", "--chunks", "0::2"]) == 0
    assert "66.7 % of the records are there" in capsys.readouterr().out
    assert len(list((tmp_path / "s").glob("chunk-*"))) == 2
    assert run([*ASKED, *out]) == 0
    printed = capsys.readouterr().out
    assert "smith_1972" in printed and "median RMSE" in printed
    assert (tmp_path / "s.png").stat().st_size > 10_000
    assert run([*ASKED, *out, "--uniform"]) == 2
    assert "another study: noise differ" in capsys.readouterr().err


@pytest.mark.parametrize(
    "change, said",
    [
        (["--methods", "none"], "Unknown method"),
        (["--orders", "two"], "--orders takes whole numbers"),
        (["--orders", "7-9"], "order of a plant"),
        (["--noise", "much"], "--noise takes numbers"),
        (["--chunks", "3"], "--chunks takes FIRST::STEP"),
        (["--chunks", "0::0"], "STEP of at least 1"),
        (["--plants", "0"], "plants of a Study"),
        (["--plot", "/none/x.png"], "no folder"),
    ],
)
def test_what_it_cannot_do_is_one_sentence(change, said, tmp_path, capsys):
    assert run([*ASKED, "--out", str(tmp_path / "s"), *change]) == 2
    error = capsys.readouterr().err
    assert said in error and "Traceback" not in error
    assert not list(tmp_path.iterdir())


@pytest.mark.long
def test_interrupted_it_goes_on(tmp_path):
    command = [sys.executable, "-c", "from stepax._cli import main; main()", *ASKED]
    command += ["--plants", "600", "--chunk", "1", "--out", str(tmp_path / "s")]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as running:
        while len(list((tmp_path / "s").glob("chunk-*"))) < 3:
            assert running.poll() is None
            time.sleep(0.02)
        error = None
        while error is None:  # pressed again: one that meets the garbage collection may be lost
            running.send_signal(signal.SIGINT)
            with contextlib.suppress(subprocess.TimeoutExpired):
                error = running.communicate(timeout=3)[1]
    assert running.returncode == 130 and "the same command goes on" in error
    assert "Traceback" not in error
    subprocess.run(command, check=True, capture_output=True)
    assert len(list((tmp_path / "s").glob("chunk-*"))) == 1200
