"""Commands of ``deepct`` that a cluster runs in shares, or for each of many files."""

import json
import os
import shutil
import subprocess
from pathlib import Path

import h5py
import pytest

from weights_tools.__main__ import main

DEEPCT = os.environ.get("DEEPCT") or shutil.which("deepct")

EXPERIMENT = """
generated = 3
methods = ["network", "quick-hybrid"]
samples_per_pixel = 8
quick_iterations = 1
"""


def deepct(folder: Path, command: str) -> None:
    assert DEEPCT, "deepct is not on the PATH and DEEPCT does not name it"
    subprocess.run([DEEPCT, "-q", *command.split()], cwd=folder, check=True)


def extinction(path: Path) -> bytes:
    with h5py.File(path) as file:
        return file["extinction"][...].tobytes()


def test_an_experiment_in_shares_is_that_of_one_process(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
):
    monkeypatch.chdir(tmp_path)
    Path("e.toml").write_text(EXPERIMENT)
    deepct(tmp_path, "experiment e.toml --out single")
    flags = ["--workers", "2", "--shares", "2", "--deepct", DEEPCT]
    assert main(["distribute", *flags, "--", "experiment", "e.toml", "--out", "shared"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("share 1 of 2, 0:00:")
    assert "6 results, 0 of them made now" in lines
    assert Path("shared/report.md").exists()
    results = sorted(path.name for path in Path("single/results").iterdir())
    assert len(results) == 6
    for name in results:
        one, other = (json.loads((Path(at) / "results" / name).read_text()) for at in ("single", "shared"))
        assert {**one, "seconds": 0} == {**other, "seconds": 0}
        volume = Path("volumes") / name.replace("json", "nc")
        assert extinction("single" / volume) == extinction("shared" / volume)


def test_each_of_many_files_is_an_input(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
):
    monkeypatch.chdir(tmp_path)
    deepct(tmp_path, "cloud generate --seed 3 --set width_km=0.4 --out cloud.nc")
    for number in (1, 2):
        out = f"images-{number}.nc"
        deepct(tmp_path, f"render cloud.nc --views cloudct-10 --samples 8 --seed {number} --out {out}")
        deepct(tmp_path, f"infer {out} --carve --out alone-{number}.nc")
    Path("images-3.nc").write_text("no images")
    files = [f"images-{number}.nc" for number in (1, 2, 3)]
    command = ["distribute", "--workers", "2", "--deepct", DEEPCT, "--out-dir", "out", "--files", *files]
    assert main([*command, "--", "infer", "--carve"]) == 2
    told = capsys.readouterr()
    assert "images-3.nc" in told.out and "1 of 3 files failed" in told.err
    for number in (1, 2):
        assert extinction(Path(f"alone-{number}.nc")) == extinction(Path(f"out/images-{number}.nc"))
    assert not Path("out/images-3.nc").exists()

    # What exists is left as it is.
    before = Path("out/images-1.nc").stat().st_mtime_ns
    shutil.copy("images-2.nc", "images-3.nc")
    assert main([*command, "--", "infer", "--carve"]) == 0
    assert "file 1 of 1, " in capsys.readouterr().out
    assert Path("out/images-1.nc").stat().st_mtime_ns == before


def test_wrong_combinations_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture):
    for flags, said in [
        (["--files", "a.nc"], "needs --files and --out-dir together"),
        (["--files", "a.nc", "--out-dir", "o", "--shares", "2"], "--shares"),
        (["--files", "a.nc", "b/a.nc", "--out-dir", str(tmp_path / "o")], "two files of one name"),
        (["--files", "a.nc", "--out-dir", str(tmp_path / "o")], "/nowhere/deepct"),
        ([], "`infer` has no shares"),
    ]:
        flags = ["--workers", "1", "--deepct", "/nowhere/deepct", *flags]
        assert main(["distribute", *flags, "--", "infer"]) == 2
        told = capsys.readouterr()
        assert said in told.err + told.out
