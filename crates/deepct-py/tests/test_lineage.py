"""The time of a field and its history: files keep them from step to step, as on the command line."""

import copy
import pickle

import h5py
import numpy as np
import pytest
import xarray

import deepct_py


@pytest.fixture(scope="module")
def simulation(tmp_path_factory):
    """Liquid water at two times, written by a program that states its history."""
    path = tmp_path_factory.mktemp("simulation") / "les.nc"
    water = np.zeros((2, 8, 16, 16))
    water[:, 2:6, 5:11, 5:11] = 0.3
    axes = {name: (name, step * (np.arange(length) + 0.5), {"units": "m"})
            for name, length, step in (("z", 8, 40.0), ("y", 16, 50.0), ("x", 16, 50.0))}
    time = {"units": "seconds since 2004-07-01", "calendar": "standard"}
    dataset = xarray.Dataset(
        {"ql": (("time", "z", "y", "x"), water, {"units": "g m-3"})},
        {**axes, "time": ("time", [300.0, 600.0], time)},
        {"history": "ncrcat parts.nc les.nc"},
    )
    dataset.to_netcdf(path)
    return path


@pytest.fixture(scope="module")
def cloud(simulation):
    return deepct_py.import_cloud(simulation, time=1, spacing="file", droplets=80)


def stored(path):
    """Time, units and history in a file, by another reader."""
    with h5py.File(path) as file:
        text = [file["time"].attrs["units"], file.attrs["history"]]
        return (file["time"][()], *(part.decode() if isinstance(part, bytes) else part for part in text))


def test_an_import_has_the_lineage_of_that_of_the_command_line(
    simulation, cloud, tmp_path, command_line
):
    command_line("cloud", "import", simulation, "--time", 1, "--spacing", "file", "--droplets", 80,
                 "--out", tmp_path / "command.nc")
    cloud.to_netcdf(tmp_path / "python.nc")
    expected = stored(tmp_path / "command.nc")
    assert stored(tmp_path / "python.nc") == expected
    assert expected[0] == 600.0 and expected[2].endswith("\nncrcat parts.nc les.nc")
    assert cloud.lineage.time == 600.0 and cloud.lineage.calendar == "standard"
    # Reading and writing adds nothing.
    deepct_py.read_cloud(tmp_path / "command.nc").to_netcdf(tmp_path / "again.nc")
    assert stored(tmp_path / "again.nc") == expected
    with xarray.open_dataset(simulation) as dataset:
        found = deepct_py.import_cloud(dataset, time=1, spacing="file", droplets=80).lineage
    assert (found.time, found.history.splitlines()[1]) == (600.0, "ncrcat parts.nc les.nc")


def test_each_stage_adds_a_line(cloud, tmp_path, command_line):
    cloud.to_netcdf(tmp_path / "cloud.nc")
    light = deepct_py.Light(phase="mie", extinction="mie", sun=(30, 45))
    images = deepct_py.render(cloud, views="cloudct-10", light=light, solver="ordinates")
    noisy = deepct_py.sense(images)
    mask = deepct_py.carve(noisy, grid=cloud)
    network = deepct_py.Network.load("general", force=True)
    estimate = network.estimate(noisy, grid=cloud, mask=mask)
    start = {"mask": mask, "iterations": 1, "corrections": 1, "probes": 0}
    inverted = deepct_py.invert(noisy, grid=cloud, init=estimate, **start)
    hybrid = deepct_py.hybrid(noisy, network=network, grid=cloud, **start)
    before = cloud.lineage.history
    sensed = ["sense", "render"]
    for name, found, stages in [
        ("images", images, ["render"]), ("noisy", noisy, sensed), ("mask", mask, ["carve", *sensed]),
        ("estimate", estimate, ["infer", *sensed]), ("inverted", inverted, ["invert", *sensed]),
        ("hybrid", hybrid, ["hybrid", *sensed]),
    ]:
        lines = [f"deepct {deepct_py.__version__}: {stage}" for stage in stages]
        assert found.lineage.history == "\n".join([*lines, before]), name
        found.to_netcdf(tmp_path / f"{name}.nc")
        assert stored(tmp_path / f"{name}.nc") == (600.0, cloud.lineage.units, found.lineage.history)
    readers = {"noisy": deepct_py.read_images, "mask": deepct_py.read_mask,
               "estimate": deepct_py.read_volume, "inverted": deepct_py.read_volume}
    for name, read in readers.items():
        found = read(tmp_path / f"{name}.nc")
        found.to_netcdf(tmp_path / "again.nc", overwrite=False)
        assert stored(tmp_path / "again.nc") == stored(tmp_path / f"{name}.nc")
        with xarray.open_dataset(tmp_path / f"{name}.nc") as dataset:
            from_dataset = type(found).from_dataset(dataset)
            assert from_dataset == found and from_dataset.lineage == found.lineage
        from_dataset = type(found).from_dataset(found.to_xarray())
        assert from_dataset == found and from_dataset.lineage == found.lineage
    # A file as an argument is named, as by the command line.
    command_line("carve", tmp_path / "noisy.nc", "--grid", tmp_path / "cloud.nc",
                 "--out", tmp_path / "command.nc")
    by_file = deepct_py.carve(tmp_path / "noisy.nc", grid=tmp_path / "cloud.nc")
    assert by_file.lineage == deepct_py.read_mask(tmp_path / "command.nc").lineage
    assert by_file == mask


def test_data_sets_of_other_programs_need_no_lineage(cloud):
    """Attributes that no file can hold are not those of the arrays."""
    field = deepct_py.Cloud(cloud.grid, extinction=cloud.extinction).to_xarray()[["extinction"]]
    field.attrs = {"author": None, "steps": {"one": 1}}
    expected = f"deepct {deepct_py.__version__}: render"
    images = deepct_py.render(field, views="cloudct-10", samples=2)
    assert images.lineage == deepct_py.Lineage(history=expected)
    assert deepct_py.score(cloud, field).relative_error < 1e-6
    field.attrs["history"] = "made by hand"
    images = deepct_py.render(field, views="cloudct-10", samples=2)
    assert images.lineage.history == f"{expected}\nmade by hand"


def test_a_lineage_is_kept_but_not_compared(cloud):
    field = deepct_py.Cloud(cloud.grid, extinction=cloud.extinction)
    known = deepct_py.Cloud(cloud.grid, extinction=cloud.extinction, lineage=cloud.lineage)
    assert field == known and hash(field) == hash(known)
    assert field.lineage == deepct_py.Lineage() != known.lineage == cloud.lineage
    for same in (copy.deepcopy(known), pickle.loads(pickle.dumps(known))):
        assert same.lineage == cloud.lineage
    images = deepct_py.render(known, views="cloudct-10", samples=2)
    assert images.replace(light=deepct_py.Light()).lineage == images.lineage
    assert deepct_py.sense(images.radiance) == deepct_py.sense(images.radiance)
