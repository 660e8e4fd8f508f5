"""`deepct cloud import` of small imitations of the files that models write.

Each test states the liquid water path, or another number, by hand. The imitations have the names,
units, attributes and axes of the models, and the formats of the netCDF library.
"""

import subprocess

import h5py
import netCDF4
import numpy as np
import pytest
import xarray as xr

# Liquid water on (z, y, x) in g/m3 or g/kg, different in every voxel along an axis.
WATER = np.fromfunction(lambda k, j, i: (5 * k + 3 * j + 2 * i) % 13 * 0.1, (4, 5, 6))
FORMATS = ["NETCDF4", "NETCDF4_CLASSIC", "NETCDF3_CLASSIC", "NETCDF3_64BIT_OFFSET", "NETCDF3_64BIT_DATA"]


class Cloud:
    """What the import wrote and printed."""

    def __init__(self, path, printed, warnings):
        self.printed, self.warnings = printed, warnings
        with h5py.File(path) as file:
            self.water = file["lwc"][...].astype(float) if "lwc" in file else None
            self.radius = file["reff"][...] if "reff" in file else None
            self.extinction = file["extinction"][...] if "extinction" in file else None
            self.bottom = file["z"].attrs["lower_edge"]
            self.spacing = [file[axis].attrs["spacing"] for axis in "xyz"]

    @property
    def path(self):
        """The mean liquid water path (g/m2)."""
        return self.water.sum(axis=0).mean() * 1e3 * self.spacing[2]


@pytest.fixture
def load(tmp_path, command_line_run):
    """Import a file with its own voxels, or with other options."""

    def load(path, *options):
        out = tmp_path / "imported.nc"
        options = options if "--spacing" in options else ("--spacing", "file", *options)
        done = command_line_run("cloud", "import", path, *options, "--out", out)
        return Cloud(out, done.stdout, done.stderr)

    return load


@pytest.fixture
def refused(load):
    """The only line that a refused import prints."""

    def refused(path, *options):
        with pytest.raises(subprocess.CalledProcessError) as failure:
            load(path, *options)
        assert failure.value.returncode == 2
        line = failure.value.stderr.rstrip("\n")
        assert "\n" not in line, line
        assert line.startswith(f"deepct: {path}: ")
        return line

    return refused


def axis(file, name, values, units="m", kind="f8", **attributes):
    file.createDimension(name, len(values))
    variable = file.createVariable(name, kind, (name,))
    variable[:] = values
    if units:
        variable.units = units
    variable.setncatts(attributes)
    return variable


def put(file, name, values, units, dimensions, fill=None, kind="f4", **attributes):
    variable = file.createVariable(name, kind, dimensions, fill_value=fill)
    if units:
        variable.units = units
    variable.setncatts(attributes)
    variable[:] = values
    return variable


def columns(file, names=("y", "x"), units="m"):
    """Columns of 50 m."""
    axis(file, names[0], 25.0 + 50.0 * np.arange(5), units)
    axis(file, names[1], 25.0 + 50.0 * np.arange(6), units)


def simple(path, water=WATER, units="g m-3", z=520.0 + 40.0 * np.arange(4), **attributes):
    """Liquid water on levels at z (m)."""
    with netCDF4.Dataset(path, "w") as file:
        axis(file, "z", z, **attributes)
        columns(file)
        put(file, "lwc", water, units, ("z", "y", "x"))
    return path


def bounds(path, faces, name="z"):
    with netCDF4.Dataset(path, "a") as file:
        file.createDimension("two", 2)
        put(file, f"{name}_bnds", np.c_[faces[:-1], faces[1:]], None, (name, "two"), kind="f8")
        file[name].bounds = f"{name}_bnds"


# Faces of the cells


@pytest.mark.parametrize("spacing", ["file", "0.05,0.05,0.04", "0.05,0.05,0.01"])
def test_bounds_give_stretched_levels(tmp_path, load, spacing):
    faces = np.array([0.0, 10.0, 30.0, 70.0, 150.0])
    water = np.broadcast_to(np.array([0.0, 0.0, 0.1, 0.5])[:, None, None], WATER.shape)
    path = simple(tmp_path / "stretched.nc", water, z=0.5 * (faces[1:] + faces[:-1]))
    bounds(path, faces)
    cloud = load(path, "--spacing", spacing)
    # 0.1 g/m3 in 40 m and 0.5 g/m3 in 80 m.
    assert cloud.path == pytest.approx(44.0, rel=1e-5)
    assert cloud.bottom == 0.0
    assert "levels: bounds of z" in cloud.printed


def test_bounds_of_descending_levels(tmp_path, load):
    faces = np.array([150.0, 70.0, 30.0, 10.0, 0.0])
    water = np.broadcast_to(np.array([0.5, 0.1, 0.0, 0.0])[:, None, None], WATER.shape)
    path = simple(tmp_path / "descending.nc", water, z=0.5 * (faces[1:] + faces[:-1]))
    bounds(path, faces)
    cloud = load(path)
    assert cloud.path == pytest.approx(44.0, rel=1e-5)
    # The lowest voxel of 37.5 m contains 7.5 m with 0.1 g/m3.
    assert cloud.water[0].max() == pytest.approx(0.02)


def test_bounds_with_gaps_are_refused(tmp_path, refused):
    path = simple(tmp_path / "gaps.nc")
    bounds(path, 500.0 + 40.0 * np.arange(5))
    with netCDF4.Dataset(path, "a") as file:
        file["z_bnds"][2] = [590.0, 620.0]
    assert "z_bnds: leave a gap or overlap" in refused(path)


def test_a_single_level(tmp_path, load, refused):
    path = simple(tmp_path / "level.nc", WATER[:1] * 0.0 + 0.3, z=[520.0])
    assert "single cell along z" in refused(path)
    cloud = load(path, "--spacing", "0.05,0.05,0.04")
    assert cloud.path == pytest.approx(12.0)
    assert "its cell is taken to be 40 m wide" in cloud.warnings
    bounds(path, np.array([400.0, 640.0]))
    cloud = load(path)
    assert cloud.path == pytest.approx(72.0)
    assert cloud.spacing[2] == pytest.approx(0.24)


def test_a_section_has_cells_as_wide_as_along_the_other_axis(tmp_path, load):
    path = tmp_path / "section.nc"
    with netCDF4.Dataset(path, "w") as file:
        axis(file, "z", 520.0 + 40.0 * np.arange(4))
        axis(file, "y", [25.0])
        axis(file, "x", 25.0 + 50.0 * np.arange(6))
        put(file, "lwc", 0.3, "g m-3", ("z", "y", "x"))
    cloud = load(path)
    assert cloud.path == pytest.approx(48.0)
    assert cloud.spacing[1] == pytest.approx(0.05)


FACES = np.array([0.0, 30.0, 70.0, 120.0, 180.0])


@pytest.mark.parametrize(
    "names, faces",
    [
        (("zh", "zf", "yh", "xh"), FACES),  # CM1
        (("zt", "zm", "yt", "xt"), FACES[:-1]),  # DALES, the lower faces
        (("zt", "zm", "yt", "xt"), FACES[1:]),  # UCLA-LES, the upper faces
        (("z_aac", "z_aaf", "y_aca", "x_caa"), FACES),  # Oceananigans
        (("z", "zh", "y", "x"), FACES),  # MicroHH
    ],
)
def test_faces_of_the_models_own_axis(tmp_path, load, names, faces):
    path = tmp_path / "faces.nc"
    with netCDF4.Dataset(path, "w") as file:
        axis(file, names[0], 0.5 * (FACES[1:] + FACES[:-1]))
        axis(file, names[1], faces)
        columns(file, names[2:])
        put(file, "lwc", WATER, "g m-3", (names[0], *names[2:]))
    cloud = load(path)
    assert cloud.path == pytest.approx(WATER.mean(axis=(1, 2)) @ np.diff(FACES), rel=1e-5)
    assert cloud.bottom == 0.0
    assert f"levels: {names[0]} between the faces {names[1]}" in cloud.printed


def test_stretched_levels_without_faces_begin_at_the_ground(tmp_path, load):
    thickness = 20 * 1.06 ** np.arange(4)
    faces = np.r_[0, np.cumsum(thickness)]
    cloud = load(simple(tmp_path / "centres.nc", z=0.5 * (faces[1:] + faces[:-1])))
    assert cloud.bottom == 0.0
    assert "assumed: the lowest from the ground" in cloud.printed


def test_levels_below_the_ground_are_left_out(tmp_path, load, refused):
    z = -20.0 + 40.0 * np.arange(4)
    cloud = load(simple(tmp_path / "ghost.nc", z=z))
    assert cloud.bottom == 0.0
    assert cloud.path == pytest.approx(WATER[1:].sum(axis=0).mean() * 40.0, rel=1e-5)
    assert "left out: the lowest level" in cloud.printed
    # Altitudes that are not above the ground.
    assert "below altitude 0" in refused(simple(tmp_path / "relative.nc", z=z - 80.0))


def test_water_beside_the_grid_is_mentioned(tmp_path, load):
    path = simple(tmp_path / "cut.nc")
    assert "left out" not in load(path).printed
    cut = load(path, "--base", 0.54, "--levels", 2)
    assert "left out: liquid water below the grid, under 0.540 km" in cut.printed
    assert "left out: liquid water above the grid, over 0.620 km" in cut.printed
    assert "water below the grid, under 3.000 km" in load(path, "--base", 3, "--levels", 4).printed
    assert "none in the part" in load(simple(tmp_path / "clear.nc", 0.0 * WATER)).printed


def test_stretched_levels_are_told(tmp_path, load):
    faces = np.array([480.0, 520.0, 560.0, 620.0, 700.0])
    path = simple(tmp_path / "stretched.nc", z=0.5 * (faces[:-1] + faces[1:]))
    bounds(path, faces)
    cloud = load(path)
    assert cloud.spacing[2] == 0.055
    assert "its levels are 40 to 80 m thick, and are averaged to 55 m" in cloud.warnings
    # The levels of a part may be uniform, even where those below are not.
    part = load(path, "--base", 0.48, "--levels", 2, "--spacing", "0.05,0.05,0.04")
    assert part.warnings == ""
    above = load(path, "--base", 0.56)
    assert above.spacing[2] == 0.07
    even = simple(tmp_path / "even.nc", z=[0.0, 1000.0, 1040.0, 1080.0])
    assert load(even, "--base", 1.02).spacing[2] == 0.04
    assert "thick" not in load(even, "--base", 1.02).warnings


def test_little_water_is_told(tmp_path, load, refused):
    path = simple(tmp_path / "little.nc", 2e-3 * WATER)
    assert "lwc is at most 0.0024" in load(path).warnings
    assert "too little for a cloud" in refused(simple(tmp_path / "traces.nc", 5e-4 * WATER))


# Models


@pytest.mark.parametrize("format", FORMATS)
def test_ucla_les(tmp_path, load, format):
    """States g/kg and holds kg/kg; `longname`; a level below the ground; upper faces."""
    path = tmp_path / "ucla.nc"
    with netCDF4.Dataset(path, "w", format=format) as file:
        file.Source = "UCLA-LES Version 2.0"
        file.createDimension("time", None)
        put(file, "time", [600.0], "seconds since 2000-01-01 0000", ("time",))
        for name, values in [
            ("zt", [-12.5, 12.5, 37.5, 62.5, 87.5]),
            ("zm", [0, 25, 50, 75, 100]),
            ("xt", [-25, 25]),
            ("yt", [-25, 25]),
        ]:
            axis(file, name, values, kind="f4", longname="Displacement of cells")
        fill = np.float32(-999.0)
        density = [1.17, 1.17, 1.167, 1.165, 1.162]
        put(file, "dn0", density, "kg/m^3", ("zt",), fill, longname="Base-state density")
        field = ("time", "yt", "xt", "zt")
        put(file, "q", 0.016, "g/kg", field, fill, longname="Total water mixing ratio")
        water = put(file, "l", 0.0, "g/kg", field, fill, longname="Liquid water mixing ratio")
        water[0] = [0.0, 0.0, 2e-4, 4e-4, 0.0]
    cloud = load(path)
    assert cloud.path == pytest.approx(25e3 * (2e-4 * 1.167 + 4e-4 * 1.165), rel=1e-5)
    assert cloud.bottom == 0.0
    assert "UCLA-LES writes kg/kg" in cloud.warnings
    # A date that does not exist, which UCLA-LES writes, would make the file unreadable for xarray.
    with netCDF4.Dataset(path, "a") as file:
        file["time"].units = "seconds since 2000-00-00 0000"
    load(path)
    with xr.open_dataset(tmp_path / "imported.nc", decode_timedelta=False) as imported:
        assert imported.time == 600.0 and imported.time.units == "seconds"
    assert "density of air: dn0" in cloud.printed
    # Numbers that can only be in g/kg stay so.
    with netCDF4.Dataset(path, "a") as file:
        file["l"][:] *= 1000.0
    assert load(path).path == pytest.approx(cloud.path, rel=1e-5)


@pytest.mark.parametrize("format", FORMATS)
@pytest.mark.parametrize("faces", [True, False])
def test_palm(tmp_path, load, format, faces):
    """The lowest level is on the ground and holds the fill value."""
    path = tmp_path / "palm.nc"
    with netCDF4.Dataset(path, "w", format=format) as file:
        file.createDimension("time", None)
        put(file, "time", [1805.68], "seconds", ("time",), standard_name="time", axis="T")
        axis(file, "zu_3d", [0.0, 20.0, 60.0, 100.0, 140.0], "meters", axis="Z")
        if faces:
            axis(file, "zw_3d", [0.0, 40.0, 80.0, 120.0, 160.0], "meters", axis="Z")
        axis(file, "x", [50.0, 150.0], "meters", axis="X")
        axis(file, "y", [50.0, 150.0], "meters", axis="Y")
        put(file, "E_UTM", [500050.0, 500150.0], "m", ("x",), standard_name="projection_x_coordinate")
        water = put(file, "ql", 0.0, "kg/kg", ("time", "zu_3d", "y", "x"), np.float32(-9999.0))
        water[0] = np.array([-9999.0, 0.0, 2e-4, 4e-4, 0.0])[:, None, None]
    cloud = load(path, "--air-density", 1.2)
    assert cloud.path == pytest.approx(1.2 * 40e3 * 6e-4, rel=1e-5)
    assert cloud.bottom == 0.0
    assert cloud.spacing[2] == pytest.approx(0.04)
    assert "left out: the lowest level" in cloud.printed


@pytest.mark.parametrize("format", FORMATS)
def test_sam(tmp_path, load, format):
    """Padded units, radii in mkm, time in d, water with ice, density from p (mb) and TABS."""
    path = tmp_path / "sam.nc"
    with netCDF4.Dataset(path, "w", format=format) as file:
        for name, values in [("x", [0, 100]), ("y", [0, 100]), ("z", [20, 60, 100, 140])]:
            axis(file, name, values, kind="f4")
        file.createDimension("time", None)
        put(file, "time", [180.04], "d", ("time",))
        pressure, temperature = np.array([1012, 1008, 1003, 999.0]), np.array([290, 290, 289, 289.0])
        put(file, "p", pressure, "mb", ("z",))
        field = ("time", "z", "y", "x")
        name = "Non-precipitating Condensate (Water+Ice)          "
        water = put(file, "QN", 0.0, "g/kg      ", field, long_name=name)
        water[0] = np.array([0.0, 0.2, 0.4, 0.0])[:, None, None]
        warmth = put(file, "TABS", 0.0, "K         ", field)
        warmth[0] = temperature[:, None, None]
        radius = put(file, "REL", 0.0, "mkm       ", field)
        radius[0] = np.array([0.0, 8.0, 10.0, 0.0])[:, None, None]
    cloud = load(path)
    density = 100.0 * pressure / (287.04 * temperature)
    assert cloud.path == pytest.approx(40.0 * (0.2 * density[1] + 0.4 * density[2]), rel=1e-5)
    assert cloud.radius[1].max() == pytest.approx(8.0)
    assert "water and ice" in cloud.warnings
    assert "density of air: from p, TABS" in cloud.printed
    # SAM computes water paths with the density of all air: p / (R T (1 + 0.61 qv)).
    with netCDF4.Dataset(path, "a") as file:
        put(file, "QV", 16.0, "g/kg      ", field)
    moist = load(path)
    assert moist.path == pytest.approx(cloud.path / (1.0 + (461.5 / 287.04 - 1.0) * 0.016), rel=1e-5)
    assert "from p, TABS, QV (all air)" in moist.printed


def test_cm1(tmp_path, load):
    """Lengths in km; density of dry air from potential temperature, pressure and vapour."""
    path = tmp_path / "cm1.nc"
    faces = 1e-3 * FACES
    centres = 0.5 * (faces[1:] + faces[:-1])
    pressure = 1e5 - 12000.0 * centres[:, None, None] + 0 * WATER
    with netCDF4.Dataset(path, "w", format="NETCDF4_CLASSIC") as file:
        file.createDimension("time", None)
        axis(file, "xh", 0.025 + 0.05 * np.arange(6), "km", axis="X")
        axis(file, "yh", 0.025 + 0.05 * np.arange(5), "km", axis="Y")
        axis(file, "zh", centres, "km", axis="Z")
        axis(file, "zf", faces, "km", axis="Z")
        for name, units, values in [
            ("qc", "kg/kg", 1e-3 * WATER),
            ("th", "K", 290.0),
            ("prs", "Pa", pressure),
            ("qv", "kg/kg", 0.012),
        ]:
            put(file, name, 0.0, units, ("time", "zh", "yh", "xh"))[0] = values
    temperature = 290.0 * (pressure / 1e5) ** (287.04 / 1005.7)
    density = pressure / (287.04 * temperature * (1 + 0.012 * 461.5 / 287.04))
    path_of_model = (WATER * density).mean(axis=(1, 2)) @ np.diff(FACES)
    cloud = load(path)
    assert cloud.path == pytest.approx(path_of_model, rel=1e-5)
    assert "from prs, th, qv (dry air)" in cloud.printed


def test_cm1_with_dimensions_of_other_names(tmp_path, load):
    path = tmp_path / "cm1.nc"
    with netCDF4.Dataset(path, "w") as file:
        file.createDimension("time", 1)
        for dimension, name, count, step in [("nk", "z", 4, 0.04), ("nj", "yh", 5, 0.05), ("ni", "xh", 6, 0.05)]:
            file.createDimension(dimension, count)
            put(file, name, np.arange(count) * step, "km", (dimension,))
        put(file, "qc", 1e-3 * WATER, "kg/kg", ("time", "nk", "nj", "ni"))
    cloud = load(path, "--air-density", 1)
    assert cloud.path == pytest.approx(WATER.sum(axis=0).mean() * 40.0, rel=1e-5)
    assert "a grid from --base 0 on leaves that part out" in cloud.warnings


def test_wrf_without_coordinates(tmp_path, load):
    path = tmp_path / "wrf.nc"
    levels = ("Time", "bottom_top", "south_north", "west_east")
    with netCDF4.Dataset(path, "w", format="NETCDF3_64BIT_OFFSET") as file:
        for name, count in zip((*levels, "bottom_top_stag"), (None, 4, 5, 6, 5)):
            file.createDimension(name, count)
        file.DX, file.DY = 50.0, 50.0
        put(file, "QCLOUD", 0.0, "kg kg-1", levels, description="Cloud water mixing ratio")[0] = 1e-3 * WATER
        faces = ("Time", "bottom_top_stag", *levels[2:])
        put(file, "PH", 0.0, "m2 s-2", faces)[0] = 0.25 * 9.81 * FACES[:, None, None]
        put(file, "PHB", 0.0, "m2 s-2", faces)[0] = 0.75 * 9.81 * FACES[:, None, None]
        put(file, "ALT", 0.0, "m3 kg-1", levels)[0] = 0.8
    cloud = load(path)
    expected = (WATER / 0.8).mean(axis=(1, 2)) @ np.diff(FACES)
    assert cloud.path == pytest.approx(expected, rel=1e-5)
    assert cloud.spacing[:2] == pytest.approx([0.05, 0.05])
    assert "(PH + PHB) / 9.81" in cloud.printed and "1 / ALT" in cloud.printed


def test_breeze(tmp_path, load):
    """Variables without attributes; the condensate is a density."""
    path = tmp_path / "breeze.nc"
    with netCDF4.Dataset(path, "w") as file:
        file.createDimension("time", None)
        put(file, "time", [3600.0], "seconds", ("time",))
        axis(file, "z_aac", 20.0 + 40.0 * np.arange(4), axis="Z")
        axis(file, "z_aaf", 40.0 * np.arange(5), axis="Z")
        axis(file, "y_aca", [50.0, 150.0], axis="Y")
        axis(file, "x_caa", [50.0, 150.0], axis="X")
        field = ("time", "z_aac", "y_aca", "x_caa")
        put(file, "qˡ", 0.0, None, field)[0] = np.array([0, 2e-4, 4e-4, 0])[:, None, None]
        put(file, "ρqᶜˡ", 0.0, None, field)[0] = np.array([0, 2.3e-4, 4.6e-4, 0])[:, None, None]
    cloud = load(path)
    assert cloud.path == pytest.approx(27.6, rel=1e-5)
    assert "ρqᶜˡ has no units, and is taken to be in kg m-3" in cloud.warnings
    ratio = load(path, "--variable", "qˡ", "--air-density", 1.1)
    assert ratio.path == pytest.approx(1.1 * 40.0 * 0.6, rel=1e-5)
    assert "qˡ has no units, and is taken to be in kg kg-1" in ratio.warnings


def test_tiles_that_were_joined_along_a_staggered_axis(tmp_path, refused):
    path = tmp_path / "tiles.nc"
    with netCDF4.Dataset(path, "w") as file:
        axis(file, "ym", [0.0, 100.0])
        axis(file, "time", [1800.0], "s")
        axis(file, "zt", [20.0, 60.0])
        axis(file, "yt", [50.0, 150.0])
        axis(file, "xt", [50.0, 150.0])
        put(file, "ql", 2e-4, "kg/kg", ("ym", "time", "zt", "yt", "xt"))
    line = refused(path)
    assert "of which ym is that of the faces" in line and 'data_vars="minimal"' in line


@pytest.mark.parametrize("format", ["NETCDF4", "NETCDF3_CLASSIC"])
def test_i3rc(tmp_path, load, refused, format):
    """Faces alone, extinction, no units."""
    path = tmp_path / "i3rc.nc"
    with netCDF4.Dataset(path, "w", format=format) as file:
        for name, values in [("x", [0, 30, 60]), ("y", [0, 30, 60]), ("z", [200, 220, 240, 260])]:
            axis(file, f"{name}-Edges", values, None, "f4")
            file.createDimension(f"{name}-Grid", len(values) - 1)
        field = ("z-Grid", "y-Grid", "x-Grid")
        extinction = np.array([0, 0, 0, 0, 0.02, 0.02, 0.01, 0.01, 0.02, 0, 0.01, 0]).reshape(3, 2, 2)
        put(file, "Component1_Extinction", extinction, None, field)
        put(file, "Component1_SingleScatteringAlbedo", 1.0, None, field)
    line = refused(path)
    options = line.split("such as ")[1].split()
    assert options[:2] == ["--units", "x-Edges=m"]
    cloud = load(path, *options)
    np.testing.assert_allclose(cloud.extinction, 1e3 * extinction, rtol=1e-6)
    assert cloud.bottom == pytest.approx(0.2)
    assert cloud.spacing == pytest.approx([0.03, 0.03, 0.02])


# Density of air


def dales(path):
    with netCDF4.Dataset(path, "w") as file:
        axis(file, "zt", 20.0 + 40.0 * np.arange(4))
        columns(file, ("yt", "xt"))
        name = "Liquid water specific humidity"
        put(file, "ql", 1e-3 * WATER, "kg/kg", ("zt", "yt", "xt"), long_name=name)
    return path


DENSITY = 1.2 - 0.01 * np.arange(6)


def test_density_of_a_profile_in_another_file(tmp_path, load, refused):
    path, profiles = dales(tmp_path / "dales.nc"), tmp_path / "profiles.001.nc"
    with netCDF4.Dataset(profiles, "w") as file:
        file.createDimension("time", 3)
        axis(file, "zt", 20.0 + 40.0 * np.arange(6))
        put(file, "rhobf", DENSITY, "kg/m^3", ("time", "zt"))
        put(file, "cloud", np.arange(3)[:, None] + DENSITY, "kg/m^3", ("time", "zt"))
        group = file.createGroup("default")
        axis(group, "z", 20.0 + 40.0 * np.arange(6))
        put(group, "rhoref", DENSITY, "kg m-3", ("z",))
        axis(file, "zm", 40.0 * np.arange(7))
        put(file, "edges", np.r_[DENSITY + 0.005, DENSITY[-1] - 0.005], "kg m-3", ("zm",))
    expected = 40.0 * WATER.mean(axis=(1, 2)) @ DENSITY[:4]
    for variable in ("rhobf", "default/rhoref", "edges"):
        cloud = load(path, "--air-density", f"{profiles}:{variable}")
        assert cloud.path == pytest.approx(expected, rel=1e-5)
        assert f"density of air: {profiles}:{variable}" in cloud.printed
    with pytest.raises(subprocess.CalledProcessError) as failure:
        load(path, "--air-density", f"{profiles}:cloud")
    assert "cloud: differs between its times" in failure.value.stderr


def test_density_on_the_faces_of_the_levels(tmp_path, load):
    path = dales(tmp_path / "dales.nc")
    with netCDF4.Dataset(path, "a") as file:
        axis(file, "zm", 40.0 * np.arange(5))
        put(file, "rho", 1.205 - 0.01 * np.arange(5), "kg m-3", ("zm",))
    expected = 40.0 * WATER.mean(axis=(1, 2)) @ DENSITY[:4]
    assert load(path).path == pytest.approx(expected, rel=1e-5)


def test_density_of_the_standard_atmosphere(tmp_path, load):
    cloud = load(dales(tmp_path / "dales.nc"))
    # Densities of the US Standard Atmosphere, 1976, at 20, 60, 100 and 140 m.
    density = 1.225 * (1 - 2.25577e-5 * np.array([20.0, 60.0, 100.0, 140.0])) ** 4.2559
    assert cloud.path == pytest.approx(40.0 * WATER.mean(axis=(1, 2)) @ density, rel=1e-4)
    assert "standard atmosphere is used" in cloud.warnings and "--air-density" in cloud.warnings


def test_density_for_water_per_mass_of_all_air(tmp_path, load):
    path = dales(tmp_path / "dales.nc")
    with netCDF4.Dataset(path, "a") as file:
        for name, units, value in [("p", "Pa", 1e5), ("ta", "K", 290.0), ("qv", "kg/kg", 0.016)]:
            put(file, name, value, units, ("zt",))
    cloud = load(path)
    density = 1e5 / (287.04 * 290.0 * (1 + (461.5 / 287.04 - 1) * 0.016))
    assert cloud.path == pytest.approx(40.0 * density * WATER.sum(axis=0).mean(), rel=1e-5)


# Axes, groups and types


def test_variables_in_groups(tmp_path, load):
    path = tmp_path / "groups.nc"
    with netCDF4.Dataset(path, "w") as file:
        inner = file.createGroup("scatterers").createGroup("cloud")
        axis(inner, "z", 520.0 + 40.0 * np.arange(4))
        columns(inner)
        put(inner, "lwc", WATER, "g m-3", ("z", "y", "x"))
        put(inner, "reff", 17.0 + 0.0 * WATER, "um", ("z", "y", "x"))
    for options in ((), ("--variable", "scatterers/cloud/lwc")):
        cloud = load(path, *options)
        assert cloud.path == pytest.approx(40.0 * WATER.sum(axis=0).mean(), rel=1e-5)
        with netCDF4.Dataset(tmp_path / "imported.nc") as file:
            assert file["reff"][:].max() == pytest.approx(17.0)


def test_dimensions_of_a_parent_group(tmp_path, load, refused):
    path = tmp_path / "parent.nc"
    with netCDF4.Dataset(path, "w") as file:
        axis(file, "z", 520.0 + 40.0 * np.arange(4))
        columns(file)
        put(file.createGroup("fields"), "condensate", WATER, "g m-3", ("z", "y", "x"))
    assert "fields/condensate" in refused(path)
    cloud = load(path, "--variable", "fields/condensate")
    assert cloud.path == pytest.approx(40.0 * WATER.sum(axis=0).mean(), rel=1e-5)


def test_altitudes_that_depend_on_the_time(tmp_path, load):
    path = tmp_path / "times.nc"
    with netCDF4.Dataset(path, "w") as file:
        file.createDimension("time", 2)
        file.createDimension("z", 4)
        columns(file)
        put(file, "z", 20.0 + 40.0 * np.arange(4) + np.array([[500.0], [700.0]]), "m", ("time", "z"))
        put(file, "lwc", WATER, "g m-3", ("time", "z", "y", "x"))
    assert load(path).bottom == pytest.approx(0.5)
    assert load(path, "--time", 1).bottom == pytest.approx(0.7)


def test_dimensions_by_the_numbers_of_the_netcdf_library(tmp_path, load):
    """Files whose scales are not attached have numbers of the dimensions."""
    path = simple(tmp_path / "numbers.nc")
    with h5py.File(path, "a") as file:
        for number, name in enumerate("zyx"):
            del file[name].attrs["REFERENCE_LIST"]
            file[name].attrs["_Netcdf4Dimid"] = np.int32(number)
        del file["lwc"].attrs["DIMENSION_LIST"]
        file["lwc"].attrs["_Netcdf4Coordinates"] = np.array([0, 1, 2], "i4")
    assert load(path).path == pytest.approx(40.0 * WATER.sum(axis=0).mean(), rel=1e-5)


def test_integer_descending_rounded_and_single_axes(tmp_path, load):
    expected = pytest.approx(40.0 * WATER.sum(axis=0).mean(), rel=1e-5)
    assert load(simple(tmp_path / "integer.nc", kind="i4")).path == expected
    falling = load(simple(tmp_path / "falling.nc", WATER[::-1], z=640.0 - 40.0 * np.arange(4)))
    assert falling.path == expected
    np.testing.assert_allclose(falling.water, WATER, atol=1e-6)
    path = tmp_path / "rounded.nc"
    with netCDF4.Dataset(path, "w") as file:
        for name, count, step in [("z", 4, 0.04), ("y", 5, 1 / 30), ("x", 6, 1 / 30)]:
            axis(file, name, np.round(0.5 + np.arange(count) * step, 3), "km")
        file.createDimension("member", 1)
        put(file, "lwc", WATER, "g m-3", ("member", "z", "y", "x"))
    assert load(path).path == expected
    with netCDF4.Dataset(path, "a") as file:
        file["x"][:] = 0.5 + np.array([0.0, 0.033, 0.067, 0.1, 0.14, 0.19])
    with pytest.raises(subprocess.CalledProcessError, match="exit status 2"):
        load(path)


def test_numbers_without_units_are_assumed_with_a_warning(tmp_path, load, refused):
    path = tmp_path / "microhh.nc"
    with netCDF4.Dataset(path, "w") as file:
        axis(file, "z", 20.0 + 40.0 * np.arange(4), None)
        columns(file, units=None)
        put(file, "ql", 1e-3 * WATER, None, ("z", "y", "x"))
    cloud = load(path, "--air-density", 1)
    assert cloud.path == pytest.approx(40.0 * WATER.sum(axis=0).mean(), rel=1e-5)
    assert "z has no units; its steps of 40 are taken to be in m" in cloud.warnings
    assert "ql has no units, and is taken to be in kg kg-1" in cloud.warnings
    with netCDF4.Dataset(path, "a") as file:
        file["ql"][:] *= 1e3
    assert '--units ql="g kg-1"' in refused(path, "--air-density", 1)


@pytest.mark.parametrize("units", ["1e-5kg/kg", "1e-5 kg/kg", "1E-05 kg kg-1", "10^-5 kg/kg", "0.01 g/kg"])
def test_units_with_a_number(tmp_path, load, refused, units):
    """DALES writes integers in 1e-5 kg/kg; its old files state this unit, but hold kg/kg."""
    path = tmp_path / "fielddump.nc"
    for numbers, kind in [(100.0 * WATER, "i2"), (100.0 * WATER, "f4"), (1e-3 * WATER, "f4")]:
        with netCDF4.Dataset(path, "w") as file:
            axis(file, "z", 520.0 + 40.0 * np.arange(4))
            columns(file)
            put(file, "ql", np.round(numbers, 6), units, ("z", "y", "x"), kind=kind)
        if kind == "i2" or numbers.max() > 1.0:
            cloud = load(path, "--air-density", "1.1")
            np.testing.assert_allclose(cloud.water, 1.1 * WATER, rtol=1e-5, atol=1e-6)
            assert f'are multiplied by the one in its units "{units}"' in cloud.warnings
        else:
            assert '--units ql="kg kg-1"' in refused(path, "--air-density", "1.1")
            cloud = load(path, "--air-density", "1.1", "--units", "ql=kg kg-1")
            np.testing.assert_allclose(cloud.water, 1.1 * WATER, rtol=1e-5, atol=1e-6)


def test_numbers_of_droplets_per_mass_of_air(tmp_path, load):
    """100 per mg of air of 1.1 kg/m3 are 110 per cm3; the density is stated once."""
    path = simple(tmp_path / "cloud.nc", water=1e-3 * WATER, units="kg kg-1")
    with netCDF4.Dataset(path, "a") as file:
        put(file, "nc", np.full(WATER.shape, 1e8), "kg-1", ("z", "y", "x"))
    cloud = load(path, "--air-density", "1.1")
    wet = WATER > 0
    # reff = (3 lwc / (4 pi rho_w k N))^(1/3) with k = 0.8 depends on lwc / N, in which the density cancels.
    ratio = cloud.radius[wet] / np.cbrt(WATER[wet])
    np.testing.assert_allclose(ratio, ratio[0], rtol=1e-5)
    assert cloud.printed.count("density of air") == 1
    cloud = load(path)
    np.testing.assert_allclose(cloud.radius[wet] / np.cbrt(WATER[wet]), ratio[0], rtol=1e-5)
    assert cloud.warnings.count("that of the standard atmosphere") == 1
    simple(path)
    with netCDF4.Dataset(path, "a") as file:
        put(file, "nc", np.full(WATER.shape, 1e8), "kg-1", ("z", "y", "x"))
    assert "nc is per mass of air, and the file has no density of air" in load(path).warnings


def test_terrain_is_no_cloud(tmp_path, load):
    water = np.ma.array(np.full(WATER.shape, 0.3))
    water[0, :, :2] = np.ma.masked
    path = tmp_path / "terrain.nc"
    with netCDF4.Dataset(path, "w") as file:
        axis(file, "z", 520.0 + 40.0 * np.arange(4))
        columns(file)
        put(file, "lwc", water, "g m-3", ("z", "y", "x"), np.float32(-9999.0))
    cloud = load(path)
    assert cloud.path == pytest.approx(0.3 * 40.0 * (4 - 1 / 3), rel=1e-5)
    assert "10 voxels at the bottom" in cloud.warnings


def test_radii_on_fewer_axes_and_in_another_order(tmp_path, load):
    """Each variable has its own axes: a profile of radii applies to all columns."""
    path = tmp_path / "radii.nc"
    profile = np.array([6.0, 8.0, 10.0, 12.0])
    for name, values, dimensions in [
        ("profile", profile, ("z",)),
        ("field", profile[:, None, None] + 0 * WATER, ("z", "y", "x")),
        ("transposed", (profile[:, None, None] + 0 * WATER).T, ("x", "y", "z")),
    ]:
        with netCDF4.Dataset(path, "w") as file:
            file.createDimension("time", 1)
            axis(file, "z", 520.0 + 40.0 * np.arange(4))
            columns(file)
            put(file, "lwc", 0.1 + WATER, "g m-3", ("time", "z", "y", "x"))
            put(file, "reff", values, "um", dimensions)
        cloud = load(path)
        np.testing.assert_allclose(cloud.radius, profile[:, None, None] + 0 * WATER, err_msg=name)


def test_half_precision(tmp_path, load):
    path = simple(tmp_path / "half.nc")
    with h5py.File(path, "a") as file:
        del file["lwc"]
        half = file.create_dataset("lwc", data=np.full(WATER.shape, 0.25, "f2"))
        half.attrs["units"] = "g m-3"
        for index, name in enumerate("zyx"):
            half.dims[index].attach_scale(file[name])
    assert load(path).path == pytest.approx(40.0)


# Files that cannot be read


def test_a_simulation_without_times(tmp_path, refused):
    path = tmp_path / "empty.nc"
    with netCDF4.Dataset(path, "w") as file:
        file.createDimension("time", None)
        axis(file, "z", 520.0 + 40.0 * np.arange(4))
        columns(file)
        file.createVariable("lwc", "f4", ("time", "z", "y", "x")).units = "g m-3"
    assert "has no times" in refused(path)


@pytest.mark.parametrize(
    "name, words", [("a.zarr", "Zarr"), ("a.bp", "ADIOS2"), ("folder", "is a folder; give a regular file")]
)
def test_folders(tmp_path, refused, name, words):
    (tmp_path / name).mkdir()
    assert words in refused(tmp_path / name)


def test_a_user_block(tmp_path, load):
    path = tmp_path / "matlab.mat"
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, count, step in [("z", 4, 40.0), ("y", 5, 50.0), ("x", 6, 50.0)]:
            file[name] = 520.0 + step * np.arange(count)
            file[name].attrs["units"] = "m"
            file[name].make_scale(name)
        file["lwc"] = WATER.astype("f4")
        file["lwc"].attrs["units"] = "g m-3"
        for index, name in enumerate("zyx"):
            file["lwc"].dims[index].attach_scale(file[name])
    with open(path, "r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file")
    assert load(path).path == pytest.approx(40.0 * WATER.sum(axis=0).mean(), rel=1e-5)


@pytest.mark.skipif(h5py.version.hdf5_version_tuple < (2,), reason="the library writes older formats")
@pytest.mark.parametrize(
    "name, letter, units", [("plev", "Z", "Pa"), ("lat", "Y", "degrees_north"), ("z", "Z", "hPa")]
)
def test_axes_of_other_quantities(tmp_path, refused, name, letter, units):
    path = tmp_path / "cloud.nc"
    for attributes in ({}, {"axis": letter}):
        names = [name if letter == known else known.lower() for known in "ZYX"]
        with netCDF4.Dataset(path, "w") as file:
            for dimension, length in zip(names, WATER.shape):
                other = attributes if dimension == name else {}
                unit = units if dimension == name else "m"
                axis(file, dimension, 100.0 + 10.0 * np.arange(length), unit, **other)
            put(file, "lwc", WATER, "g m-3", names)
        line = refused(path)
        assert f'lwc: has the axis {name} in "{units}", which is no length; interpolate' in line


@pytest.mark.parametrize("order", ["zyx", "xyz", "zxy"])
def test_axes_without_names(tmp_path, load, refused, order):
    """Arrays of MATLAB 7.3 have neither names of the axes nor coordinates."""
    path = tmp_path / "cloud.mat"
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, values in [("lwc", WATER), ("reff", 5.0 + WATER), ("beta", 30.0 * WATER)]:
            file[name] = values.transpose(["zyx".index(letter) for letter in order])
    with open(path, "r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(128))
    assert "--axes z,y,x --spacing" in refused(path)
    units = ("--units", "lwc=g m-3", "--units", "reff=um")
    assert "--spacing DX,DY,DZ" in refused(path, "--axes", order, *units)
    stated = ("--axes", ",".join(order), "--spacing", "0.05,0.06,0.04", "--base", "0.52")
    assert "--units lwc=" in refused(path, *stated)
    cloud = load(path, *stated, *units)
    np.testing.assert_allclose(cloud.water, WATER, rtol=1e-6)
    np.testing.assert_allclose(cloud.radius[WATER > 0], 5.0 + WATER[WATER > 0], rtol=1e-6)
    assert cloud.spacing == pytest.approx([0.05, 0.06, 0.04])
    assert cloud.bottom == pytest.approx(0.52)
    assert "cells of 50 x 60 x 40 m from the altitude 0.52 km" in cloud.printed
    assert "omit --axes" in refused(simple(tmp_path / "named.nc"), *stated)
    cloud = load(path, *stated, "--variable", "beta", "--units", "beta=km-1")
    np.testing.assert_allclose(cloud.extinction, 30.0 * WATER, rtol=1e-6)


def test_a_newer_hdf5_format(tmp_path, refused):
    path = tmp_path / "newer.h5"
    with h5py.File(path, "w", libver="latest") as file:
        file.create_dataset("lwc", data=WATER, chunks=WATER.shape, compression="gzip")
    line = refused(path)
    assert "lwc: is written in a newer HDF5 format" in line and "v114" in line


def test_a_file_that_is_open_for_writing(tmp_path, refused):
    path = tmp_path / "open.h5"
    with h5py.File(path, "w", libver=("v110", "v110")) as file:
        file["lwc"] = WATER
        file.flush()
        line = refused(path)
    assert "open" in line and ("h5clear" in line or "locks it" in line)


def test_a_filter_that_is_not_installed(tmp_path, monkeypatch, refused):
    monkeypatch.setenv("HDF5_PLUGIN_PATH", str(tmp_path))
    path = simple(tmp_path / "filter.nc")
    with h5py.File(path, "a") as file:
        del file["lwc"]
        # The pipeline of a filter without its library: the chunks are stored as they are.
        properties = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
        properties.set_chunk(WATER.shape)
        optional = 1
        properties.set_filter(32015, optional, (3,))
        space, kind = h5py.h5s.create_simple(WATER.shape), h5py.h5t.IEEE_F32LE
        stored = h5py.h5d.create(file.id, b"lwc", kind, space, properties)
        stored.write_direct_chunk((0, 0, 0), WATER.astype("f4").tobytes(), 0)
        file["lwc"].attrs["units"] = "g m-3"
        for index, name in enumerate("zyx"):
            file["lwc"].dims[index].attach_scale(file[name])
    line = refused(path)
    assert "compressed with zstd" in line and "HDF5_PLUGIN_PATH" in line


def test_sources_of_a_virtual_data_set(tmp_path, load, refused):
    path, source = tmp_path / "virtual.nc", tmp_path / "source.h5"
    simple(path)
    with h5py.File(source, "w") as file:
        file["water"] = WATER.astype("f4")
    with h5py.File(path, "a") as file:
        del file["lwc"]
        layout = h5py.VirtualLayout(WATER.shape, "f4")
        layout[:] = h5py.VirtualSource("source.h5", "water", WATER.shape)
        virtual = file.create_virtual_dataset("lwc", layout)
        virtual.attrs["units"] = "g m-3"
        for index, name in enumerate("zyx"):
            virtual.dims[index].attach_scale(file[name])
    assert "refers to other files" in refused(path)
    cloud = load(path, "--allow-external")
    assert cloud.path == pytest.approx(40.0 * WATER.sum(axis=0).mean(), rel=1e-5)
    source.rename(tmp_path / "elsewhere.h5")
    assert "its source source.h5 is missing" in refused(path, "--allow-external")


# Text, and single clouds


SHDOM = """2  parameter LWC file
 2 2 2
0.055 0.055
{altitudes}
{temperatures}
 1 1 1 0.0000  1.00
 1 2 1 0.1000  6.00
 2 1 2 0.3000  9.00
"""


@pytest.mark.parametrize(
    "altitudes, bottom", [("0.425 0.450 0.475", 0.425), ("0.425 0.450", 0.4125)]
)
def test_files_of_shdom_count_their_altitudes(tmp_path, load, refused, altitudes, bottom):
    """nz + 1 altitudes are faces, and nz centres; indices start at 1."""
    path = tmp_path / "cloud.lwc"
    temperatures = " ".join("283.5" for _ in altitudes.split())
    path.write_text(SHDOM.format(altitudes=altitudes, temperatures=temperatures))
    cloud = load(path)
    assert cloud.bottom == pytest.approx(bottom)
    assert cloud.spacing == pytest.approx([0.055, 0.055, 0.025])
    expected = np.zeros((2, 2, 2))
    expected[0, 1, 0], expected[1, 0, 1] = 0.1, 0.3
    np.testing.assert_allclose(cloud.water, expected, rtol=1e-6)
    path.write_text(SHDOM.format(altitudes="0.425", temperatures="283.5"))
    assert "line 4: has 1 altitudes, not nz = 2 or nz + 1" in refused(path)


@pytest.mark.parametrize(
    "flag, rows, quantity, expected",
    [
        (1, ["1 1 1 20.0 0.85 1.0", "3 2 2 5.0 0.85 1.0"], "extinction", [20.0, 5.0]),
        (2, ["1 1 1 20.0 8.0", "3 2 2 5.0 10.0"], "lwc", [20.0 * 8.0 / 1500.0, 5.0 * 10.0 / 1500.0]),
        (3, ["1 1 1 0.25 8.0", "3 2 2 0.5 10.0"], "lwc", [0.25, 0.5]),
    ],
)
def test_files_of_mystic(tmp_path, load, flag, rows, quantity, expected):
    """The faces of the levels are given; an extinction becomes water by the efficiency of 2."""
    path = tmp_path / "cumulus.dat"
    path.write_text(f"3 2 3 {flag}\n0.05 0.06 0.5 0.54 0.58 0.62\n" + "\n".join(rows) + "\n")
    cloud = load(path)
    assert cloud.bottom == pytest.approx(0.5)
    assert cloud.spacing == pytest.approx([0.05, 0.06, 0.04])
    values = cloud.extinction if quantity == "extinction" else cloud.water
    field = np.zeros((3, 2, 3))
    field[0, 0, 0], field[1, 1, 2] = expected
    np.testing.assert_allclose(values, field, rtol=1e-5)
    if flag > 1:
        assert cloud.radius[0, 0, 0] == pytest.approx(8.0)
        assert cloud.radius[1, 1, 2] == pytest.approx(10.0)


def test_text_that_is_something_else_is_refused(tmp_path, refused):
    path = tmp_path / "cloud.txt"
    for text, words in [
        ("3 2 3 3\n0.05 0.05 0.5 0.54 0.58 0.62\n1 1 1 20.0 8\n", "line 3: has 20 g/m3 of water"),
        ("3 2 3 3\n0.05 0.05 0.5 0.54 0.58\n1 1 1 0.2 8\n", "has 3 altitudes, not nz + 1 = 4"),
        ("3 2 3 4\n0.05 0.05 0.5 0.54 0.58 0.62\n1 1 1 0.2 8\n", "or also a flag from 1 to 3"),
        ("P\n1 1 2\n1.0 1.0 0.5 2.0\n", "is that of a polarized property file of SHDOM, which is not read"),
        ("E\n1 1 2\n1 1 0.5 2.0\n280 280\n0.9 3 2.5\n", "line 5: is the last line, but a phase function"),
        ("E\n1 1 2\n1 1 0.5 2.0\n280 280\n0.9 -1\n", "line 5: does not begin with a number of coefficients"),
        ("T\n1 1 2\n1 1 0.5 2.0\n1e30\n1 2.5\n", "is no number of phase functions"),
        ("T\n1 1 2\n1 1 0.5 2.0\n1\n1 2.5\n1 1 1 280 20.0 1.0\n", "lacks a number: it has 6 fields, not 7"),
        ("1 1 2\n1 1 0.5 2.0\n1 1 1 280 20.0 1 1 2.5\n1 1 2 280 20.0 1 2 2.5\n", "has 8 fields, not 9"),
    ]:
        path.write_text(text)
        assert words in refused(path)


@pytest.mark.parametrize(
    "text",
    [
        "E\n{grid}\n280 280 280\n0.99 3 2.5\n4.0 3.1\n1 1 1 20.5\n3 2 3 1.5\n",
        "Tabulated phase function property file\n{grid}\n2\n2 2.5 4.1\n3 2.4 4.0\n3.0\n"
        "1 1 1 280 20.5 0.99 1\n3 2 3 280 1.5 0.9 2\n",
        "{grid}\n1 1 1 280 20.5 0.99 2 2.5 4.0\n3 2 3 280 1.5 0.9 0\n",
    ],
    ids=["extinction only", "tabulated", "standard"],
)
def test_property_files_of_shdom(tmp_path, load, command_line_run, text):
    """Layouts and lists over several lines as in the documentation of SHDOM."""
    path = tmp_path / "cloud.prp"
    path.write_text(text.format(grid="3 2 3\n0.05 0.06 0.5 0.54 0.58"))
    cloud = load(path)
    field = np.zeros((3, 2, 3))
    field[0, 0, 0], field[2, 1, 2] = 20.5, 1.5
    np.testing.assert_allclose(cloud.extinction, field, rtol=1e-6)
    assert cloud.spacing == pytest.approx([0.05, 0.06, 0.04])
    assert cloud.bottom == pytest.approx(0.48)
    warning = command_line_run("cloud", "import", path, "--out", tmp_path / "a.nc").stderr
    assert "contains that of the air if propgen added Rayleigh scattering; the least value is 0 km-1" in warning


@pytest.mark.parametrize("stated", [False, True])
def test_a_data_set_of_at3d(tmp_path, load, stated):
    """Written by xarray on the axes x, y, z of AT3D, without units unless they are stated."""
    path = tmp_path / "cloud.nc"
    axes = ("x", "y", "z")
    fields = {"density": (axes, 0.3 * WATER.T), "reff": (axes, 8.0 + WATER.T), "delx": 0.05, "dely": 0.06}
    coordinates = {"x": 0.05 * np.arange(6), "y": 0.06 * np.arange(5), "z": 0.54 + 0.04 * np.arange(4)}
    dataset = xr.Dataset(fields, coordinates)
    options = ("--variable", "density") if stated else ()
    if stated:
        units = {"density": "mg m-3", "reff": "um", "x": "km", "y": "km", "z": "km"}
        for name, unit in units.items():
            dataset[name].attrs["units"] = unit
        dataset["density"] = 1e3 * dataset["density"].assign_attrs(dataset["density"].attrs)
        dataset["density"].attrs["units"] = "mg m-3"
    dataset.to_netcdf(path)
    cloud = load(path, *options)
    np.testing.assert_allclose(cloud.water, 0.3 * WATER, rtol=1e-6)
    np.testing.assert_allclose(cloud.radius[WATER > 0], 8.0 + WATER[WATER > 0], rtol=1e-6)
    assert cloud.spacing == pytest.approx([0.05, 0.06, 0.04])
    assert cloud.bottom == pytest.approx(0.52)


def test_several_times_and_the_history(tmp_path, command_line, refused):
    path = tmp_path / "les.nc"
    with netCDF4.Dataset(path, "w") as file:
        file.history = "2020-01-01: a model"
        file.createDimension("time", 3)
        time = file.createVariable("time", "i4", ("time",))
        time.units, time.calendar = "seconds since 2004-01-01", "noleap"
        time[:] = [0, 60, 120]
        axis(file, "z", 520.0 + 40.0 * np.arange(4))
        columns(file)
        lwc = file.createVariable("lwc", "f4", ("time", "z", "y", "x"))
        lwc.units = "g m-3"
        for step in range(3):
            lwc[step] = (step + 1) * 0.3 * WATER
    read = ("cloud", "import", path, "--spacing", "file", "--quiet", "--time")
    command_line(*read, "all", "--out", tmp_path / "all")
    command_line(*read, "1:3", "--out", tmp_path / "part.nc")
    command_line(*read, "2", "--out", tmp_path / "one.nc")
    command_line("regrid", tmp_path / "one.nc", "--like", tmp_path / "one.nc", "--out", tmp_path / "again.nc")
    assert sorted(file.name for file in (tmp_path / "all").iterdir()) == [f"les_000{step}.nc" for step in range(3)]
    assert sorted(file.name for file in tmp_path.glob("part*")) == ["part_0001.nc", "part_0002.nc"]
    for step in range(3):
        with xr.open_dataset(tmp_path / "all" / f"les_000{step}.nc", decode_times=False) as cloud:
            np.testing.assert_allclose(cloud.lwc, (step + 1) * 0.3 * WATER, rtol=1e-6)
            assert cloud.time.shape == () and cloud.time == 60 * step
            assert cloud.time.attrs["units"] == "seconds since 2004-01-01"
            assert cloud.time.attrs["calendar"] == "noleap"
            line, before = cloud.attrs["history"].split("\n")
            assert line.startswith("deepct ") and line.endswith(f": cloud import les.nc --time {step}")
            assert before == "2020-01-01: a model"
    same = [(tmp_path / name).read_bytes() for name in ("all/les_0002.nc", "one.nc", "part_0002.nc")]
    assert same[0] == same[1] == same[2]
    with xr.open_dataset(tmp_path / "again.nc", decode_times=False) as cloud:
        assert cloud.time == 120 and cloud.time.attrs["calendar"] == "noleap"
        assert [line.split(": ")[1] for line in cloud.attrs["history"].split("\n")] == [
            "regrid one.nc", "cloud import les.nc --time 2", "a model"
        ]
    assert "time: has 3 times; choose --time within 0:3" in refused(path, "--time", "1:9")


def test_clouds_that_are_not_isolated_are_counted(tmp_path, command_line):
    path = tmp_path / "field.nc"
    water = np.zeros((4, 40, 40))
    water[1:, 5:8, 5:8] = 0.6
    water[1:, 20:24, 20:24] = 0.6
    with netCDF4.Dataset(path, "w") as file:
        axis(file, "z", 520.0 + 40.0 * np.arange(4))
        axis(file, "y", 25.0 + 50.0 * np.arange(40))
        axis(file, "x", 25.0 + 50.0 * np.arange(40))
        put(file, "lwc", water, "g m-3", ("z", "y", "x"))
    isolate = ("cloud", "import", path, "--spacing", "file", "--isolate", 16, "--out", tmp_path / "all")
    printed = command_line(*isolate)
    assert "1 cloud in" in printed
    assert "1 left out: 1 of fewer than 10 columns (--min-columns)" in printed
    assert "2 clouds in" in command_line(*isolate, "--min-columns", 9)
