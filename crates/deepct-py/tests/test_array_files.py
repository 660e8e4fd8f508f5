"""Clouds in files of arrays that NumPy, SciPy, pickle and Mitsuba wrote, and files that are damaged or hostile."""

import collections
import io
import json
import os
import pickle
import struct
import subprocess
import zipfile
import zlib

import h5py
import numpy as np
import pytest

import deepct_py

# Three different lengths, none of which is 1.
BETA = np.random.default_rng(3).uniform(0.5, 60.0, (4, 5, 6)) * (np.arange(6) > 1)
STATED = ("--spacing", "0.05,0.06,0.04", "--base", "0.52")


@pytest.fixture
def load(tmp_path, command_line):
    """Import a file; return the values of the variables."""

    def run(path, *options):
        out = tmp_path / "loaded.nc"
        command_line("cloud", "import", path, *options, "--out", out)
        with h5py.File(out) as file:
            return {name: file[name][...] for name in file if name not in ("bnds",)}

    return run


@pytest.fixture
def refused(tmp_path, command_line_run):
    """The one line by which the import of a file is refused."""

    def run(path, *options):
        with pytest.raises(subprocess.CalledProcessError) as failure:
            command_line_run("cloud", "import", path, *options, "--out", tmp_path / "out.nc")
        assert failure.value.returncode == 2, failure.value.stderr
        line = failure.value.stderr.rstrip("\n")
        assert "\n" not in line and len(line) < 600 and line.startswith("deepct: "), line
        assert not (tmp_path / "out.nc").exists()
        return line

    return run


def check(found, values=BETA):
    np.testing.assert_array_equal(found["extinction"], values.astype("f4"))
    np.testing.assert_allclose(found["z"], 0.54 + 0.04 * np.arange(4), rtol=1e-12)
    np.testing.assert_allclose(found["y"], 0.03 + 0.06 * np.arange(5), rtol=1e-12)


def ordered(order, values=BETA):
    return values.transpose(["zyx".index(letter) for letter in order])


def extinction(name, order="zyx"):
    return ("--variable", name, "--units", f"{name}=km-1", "--axes", ",".join(order), *STATED)


# NumPy


@pytest.mark.parametrize("order", ["zyx", "xyz", "yxz"])
@pytest.mark.parametrize("dtype", ["<f8", ">f8"])
@pytest.mark.parametrize("fortran", [False, True])
def test_an_array_of_numpy(tmp_path, load, order, dtype, fortran):
    path = tmp_path / "beta.npy"
    layout = "F" if fortran else "C"
    np.save(path, np.array(ordered(order), dtype=dtype, order=layout))
    check(load(path, *extinction("beta", order)))


@pytest.mark.parametrize("version", [(1, 0), (2, 0), (3, 0)])
def test_the_versions_of_the_format(tmp_path, load, version):
    path = tmp_path / "beta.npy"
    with open(path, "wb") as file:
        np.lib.format.write_array(file, BETA, version=version)
    check(load(path, *extinction("beta")))


@pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
def test_an_archive_of_numpy(tmp_path, load, save):
    path = tmp_path / "cloud.npz"
    save(path, lwc=0.01 * BETA.astype("f4"), reff=5.0 + 0.1 * BETA, x=np.arange(6) * 0.05, nothing=np.array("text"))
    found = load(path, "--axes", "z,y,x", "--units", "lwc=g m-3", "--units", "reff=um", *STATED)
    np.testing.assert_array_equal(found["lwc"], 0.01 * BETA.astype("f4"))
    wet = BETA > 0
    np.testing.assert_allclose(found["reff"][wet], (5.0 + 0.1 * BETA)[wet], rtol=1e-6)


def test_coordinates_in_an_archive(tmp_path, load):
    """Coordinates with the names of the axes are used, here in m."""
    path = tmp_path / "cloud.npz"
    np.savez(path, ext=BETA, z=540.0 + 40.0 * np.arange(4), y=30.0 + 60.0 * np.arange(5), x=25.0 + 50.0 * np.arange(6))
    options = ("--variable", "ext", "--units", "ext=km-1", "--axes", "z,y,x", "--spacing", "file")
    check(load(path, *options))


def test_arrays_with_the_names_of_own_variables(tmp_path, command_line_run):
    """Arrays of other programs state no units, whatever their names are."""
    path = tmp_path / "cloud.npz"
    axes = {name: 0.05 * np.arange(length) for name, length in zip("zyx", BETA.shape)}
    for fields in ({"mask": BETA > 3, "beta": BETA}, {"radiance": BETA, "uncertainty": BETA}, {"extinction": BETA}):
        np.savez(path, **axes, **fields)
        for arguments in [("convert", path, tmp_path / "a.nc"), ("score", "--truth", path, path)]:
            with pytest.raises(subprocess.CalledProcessError) as failure:
                command_line_run(*arguments)
            assert failure.value.returncode == 2 and failure.value.stderr.count("\n") == 1


def test_what_an_array_of_numpy_lacks(tmp_path, refused):
    path = tmp_path / "beta.npy"
    np.save(path, BETA)
    assert "beta: has axes without names, of the lengths [4, 5, 6]; state their order" in refused(path, *extinction("beta")[:4])
    assert 'beta: has no units, but km-1 is expected; ' in refused(path, "--variable", "beta", *extinction("beta")[4:])
    np.save(path, BETA.astype(int))
    assert "beta: has values of type int64, but real numbers" in refused(path, *extinction("beta"))
    np.save(path, np.array([None, {}]), allow_pickle=True)
    assert "beta" in refused(path, *extinction("beta"))


def test_damaged_arrays_of_numpy(tmp_path, refused):
    path = tmp_path / "beta.npy"
    np.save(path, BETA)
    whole = path.read_bytes()
    for size in (9, 40, len(whole) - 8):
        path.write_bytes(whole[:size])
        assert "is truncated or damaged" in refused(path, *extinction("beta"))
    # 10 GB in a file of a few bytes.
    path.write_bytes(whole.replace(b"(4, 5, 6), }            ", b"(1000, 1000, 1250), }   "))
    assert "declares the shape [1000, 1000, 1250], but has" in refused(path, *extinction("beta"))
    path.write_text("not an array")
    assert "has the ending .npy, but is not an array of NumPy or an archive of them; write it with" in refused(path)


def test_damaged_archives_of_numpy(tmp_path, refused):
    path = tmp_path / "cloud.npz"
    np.savez(path, beta=BETA)
    whole = path.read_bytes()
    at = whole.index(BETA.tobytes()) + 100
    path.write_bytes(whole[:at] + b"\xff" + whole[at + 1 :])
    assert "beta: cannot be read: Invalid checksum" in refused(path, *extinction("beta"))
    path.write_bytes(whole[:-30])
    assert "is truncated or damaged" in refused(path, *extinction("beta"))
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("data.pkl", b"x")
    assert "is a zip archive without arrays of NumPy; write the arrays with numpy.savez" in refused(path)
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(header, {"descr": "<f8", "fortran_order": False, "shape": (1000, 1000, 1250)})
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("beta.npy", header.getvalue() + bytes(1000))
    assert "declares the shape [1000, 1000, 1250], but has" in refused(path, *extinction("beta"))


def test_the_limit_of_the_memory(tmp_path, refused):
    """Zeros that are there, but are more than the limit."""
    path = tmp_path / "beta.npz"
    np.savez_compressed(path, beta=np.zeros((100, 500, 500), "f4"))
    line = refused(path, *extinction("beta"), "--max-memory", "0.1")
    assert "memory for the grid is 0.4 GB, but must be at most 0.1 GB" in line
    # 10 GB without content, which takes no space on the disk.
    path = tmp_path / "beta.npy"
    np.save(path, np.zeros((1, 1, 1)))
    whole = path.read_bytes()
    path.write_bytes(whole.replace(b"(1, 1, 1), }            ", b"(1000, 1000, 1250), }   "))
    os.truncate(path, 10**10 + len(whole) - 8)
    assert "memory for the grid is 20.0 GB" in refused(path, *extinction("beta"), "--max-memory", "1")


# MATLAB


@pytest.fixture(scope="module")
def scipy_io():
    return pytest.importorskip("scipy.io")


@pytest.mark.parametrize("compressed", [False, True])
@pytest.mark.parametrize("order", ["zyx", "yxz"])
def test_a_file_of_matlab(tmp_path, load, scipy_io, compressed, order):
    """Axes in the reverse order of MATLAB and SciPy, as in files of version 7.3."""
    path = tmp_path / "cloud.mat"
    content = {"beta": ordered(order), "label": "text", "other": np.arange(3), "beta_est": np.ones(3)}
    scipy_io.savemat(path, content, do_compression=compressed)
    check(load(path, *extinction("beta", order[::-1])))


@pytest.mark.parametrize("compressed", [False, True])
def test_structures_of_matlab(tmp_path, load, scipy_io, compressed):
    path = tmp_path / "cloud.mat"
    cells = np.empty((1, 2), object)
    cells[0, 0], cells[0, 1] = np.ones(2), BETA.astype("f4")
    several = np.array([(1.0, BETA), (2.0, 2 * BETA)], dtype=[("a", object), ("beta", object)])
    content = {"clouds": {"name": "one", "beta": BETA, "n": 3.0}, "cells": cells, "list": several}
    scipy_io.savemat(path, content, do_compression=compressed)
    for name, values in [("clouds/beta", BETA), ("cells/1", BETA), ("list/1/beta", 2 * BETA)]:
        check(load(path, *extinction(name, "xyz")), values)


def test_integers_that_stand_for_real_numbers(tmp_path, load):
    """MATLAB stores real numbers without fractions as integers; the file is of the other byte order."""

    def element(kind, content):
        return struct.pack(">II", kind, len(content)) + content + bytes(-len(content) % 8)

    values = np.arange(24, dtype="u1").reshape(2, 3, 4)
    matrix = element(6, struct.pack(">II", 6, 0)) + element(5, struct.pack(">3i", 4, 3, 2))
    matrix += struct.pack(">HH4s", 4, 1, b"beta") + element(2, values.tobytes())
    path = tmp_path / "cloud.mat"
    packed = zlib.compress(element(14, matrix))
    path.write_bytes(b"MATLAB 5.0 MAT-file".ljust(124) + b"\x01\x00MI" + struct.pack(">II", 15, len(packed)) + packed)
    found = load(path, *extinction("beta"))
    np.testing.assert_array_equal(found["extinction"], values)


def test_unreadable_files_of_matlab(tmp_path, refused, scipy_io):
    path = tmp_path / "cloud.mat"
    scipy_io.savemat(path, {"beta": BETA + 1j})
    assert "beta: has values of type complex numbers" in refused(path, *extinction("beta"))
    scipy_io.savemat(path, {"a": BETA, "b": BETA})
    whole = path.read_bytes()
    assert "; specify it with --variable; the file has: a, b" in refused(path)
    path.write_bytes(whole[:-8])
    assert "is truncated or damaged: an element declares" in refused(path)
    # The lengths of the axes of the first array.
    lengths = struct.pack("<3i", 4, 5, 6)
    path.write_bytes(whole.replace(lengths, struct.pack("<3i", 1000, 1000, 1250), 1))
    assert "a declares the shape [1000, 1000, 1250], but has 960 bytes" in refused(path)
    scipy_io.savemat(path, {"a": np.arange(500.0)}, do_compression=True)
    whole = path.read_bytes()
    path.write_bytes(whole[:400] + b"\xff\xff" + whole[402:])
    line = refused(path, "--variable", "a", "--units", "a=km-1", "--axes", "x,y,z", *STATED)
    assert "damaged" in line or "cannot be read" in line or "has no" in line
    path.write_bytes(b"\0\0\0\0" + bytes(100))
    assert "is not a MATLAB file of version 5 to 7.3; save it with -v7" in refused(path)
    path.write_bytes(b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM")
    assert "contains no arrays of numbers" in refused(path)


# Pickles


@pytest.mark.parametrize("protocol", [2, 3, 4, 5])
@pytest.mark.parametrize("layout", ["C", "F"])
@pytest.mark.parametrize("dtype", ["<f8", ">f4"])
def test_a_pickle(tmp_path, load, protocol, layout, dtype):
    path = tmp_path / "cloud.pkl"
    content = collections.OrderedDict(
        clouds={"beta": np.array(BETA, dtype, order=layout), "name": "é", "id": 3},
        grid=[np.float64(0.05), np.float32(0.06), 4, True, None, 2**70, 1e-3],
        cameras=[(np.eye(3), {1, 2}, b"bytes"), {"f": np.arange(3), 5: [1.5, 2.5]}],
        flags=BETA > 3,
        words=np.array(["a", "b"]),
        objects=np.array([None, {}], dtype=object),
        itself=[],
    )
    content["again"] = content["clouds"]
    path.write_bytes(pickle.dumps(content, protocol))
    found = load(path, *extinction("clouds/beta"))
    check(found, BETA.astype(dtype))
    check(load(path, *extinction("again/beta")), BETA.astype(dtype))


@pytest.mark.parametrize("protocol", [2, 3, 4, 5])
def test_a_pickle_of_one_array(tmp_path, load, refused, protocol):
    path = tmp_path / "beta.pkl"
    path.write_bytes(pickle.dumps(ordered("xyz"), protocol))
    check(load(path, *extinction("beta", "xyz")))
    path.write_bytes(pickle.dumps({"x": np.float64(3.5), "n": [1, 2.0, np.int32(3)]}, protocol))
    assert "; specify it with --variable; the file has: n, x" in refused(path)


class Command:
    """What an attacker writes."""

    def __init__(self, mark):
        self.mark = mark

    def __reduce__(self):
        return os.system, (f"touch {self.mark}",)


class Plain:
    pass


@pytest.mark.parametrize("protocol", [2, 3, 4, 5])
def test_nothing_in_a_pickle_is_executed(tmp_path, refused, protocol):
    path, mark = tmp_path / "cloud.pkl", tmp_path / "executed"
    path.write_bytes(pickle.dumps({"beta": BETA, "a": Command(mark)}, protocol))
    line = refused(path, *extinction("beta"))
    assert "names posix.system, which is not executed; only NumPy arrays, numbers" in line
    assert not mark.exists()
    for value, words in [
        (Plain(), "test_array_files.Plain"),
        (np.ma.masked_array(BETA), "numpy.ma"),
        (range(3), "range"),
        (np.random.default_rng(1), "numpy.random"),
    ]:
        path.write_bytes(pickle.dumps([value], protocol))
        line = refused(path)
        assert words in line and "write its arrays with numpy.savez" in line


def test_hostile_pickles(tmp_path, refused):
    path = tmp_path / "beta.pkl"
    whole = pickle.dumps(BETA, 4)
    shape = b"K\x04K\x05K\x06"
    path.write_bytes(whole.replace(shape, b"M\xe8\x03M\xe8\x03M\xe2\x04"))
    assert "declares the shape [1000, 1000, 1250], but has 960 bytes" in refused(path)
    for size in (3, 100, len(whole) - 3):
        path.write_bytes(whole[:size])
        assert "is truncated or damaged" in refused(path)
    damaged = {
        b"\x80\x04.": "uses an object that it lacks",
        b"\x80\x04B\xff\xff\xff\xffx.": "declares 4294967295 bytes",
        b"\x80\x04h\x07.": "uses an object that it lacks",
        b"\x80\x04t.": "a mark is missing",
        b"\x80\x04N)R.": "calls what is no function",
        b"\x80\x04cnumpy\nndarray\n)\x81.": "contains objects of classes",
        b"\x80\x04K\x01Q.": "refers to objects outside of it",
        b"\x80\x04\xff.": "there is no operation 0xff",
        b"\x80\x05\x97.": "buffers in another place",
        b"\x80\x04cnumpy\nndarray\n)R.": "wrong arguments",
        b"\x80\x04K\x01K\x02b.": "a state that it cannot have",
        b"\x80\x04" + b"(" * 100_000 + b".": "uses an object that it lacks",
    }
    for content, words in damaged.items():
        path.write_bytes(content)
        assert words in refused(path), content[:20]
    # Lists that contain the one before ten times each: 10^20 parts, and one that contains itself.
    nested = []
    for _ in range(20):
        nested = [nested] * 10
    path.write_bytes(pickle.dumps(nested, 4))
    assert "objects" in refused(path) or "structures inside each other" in refused(path)
    nested = []
    for _ in range(12):
        nested = [nested] * 10
    path.write_bytes(pickle.dumps(nested, 4))
    assert "contains more than 4194304 objects" in refused(path)
    itself = []
    itself.append(itself)
    path.write_bytes(pickle.dumps(itself, 4))
    assert "contains more than 16 structures inside each other" in refused(path)
    path.write_bytes(b"\x80\x04" + b"N" * 5_000_000 + b".")
    assert "consists of more than 4194304 objects" in refused(path)
    path.write_bytes(pickle.dumps(BETA, 0))
    assert "is not a pickle of protocol 2 to 5; write it with" in refused(path)


# Mitsuba


def volume(path, values, box, header=None):
    nz, ny, nx = values.shape
    header = header or struct.pack("<4s5i", b"VOL\x03", 1, nx, ny, nz, 1)
    path.write_bytes(header + struct.pack("<6f", *box) + values.astype("<f4").tobytes())


def test_a_volume_of_mitsuba(tmp_path, load, command_line_run, refused):
    path = tmp_path / "cloud.vol"
    volume(path, BETA, (0.0, 0.0, 0.52, 0.3, 0.3, 0.68))
    check(load(path, "--spacing", "file"))
    out = tmp_path / "cloud.nc"
    assert "the format states no units" in command_line_run("convert", path, out).stderr
    # In m, and in the unit of the box.
    volume(path, 1e-3 * BETA, (0.0, 0.0, 520.0, 300.0, 300.0, 680.0))
    units = [f"{name}={unit}" for name, unit in [("x", "m"), ("y", "m"), ("z", "m"), ("extinction", "m-1")]]
    found = load(path, "--spacing", "file", *[part for unit in units for part in ("--units", unit)])
    np.testing.assert_allclose(found["extinction"], BETA, rtol=1e-6)
    np.testing.assert_allclose(found["z"], 0.54 + 0.04 * np.arange(4), rtol=1e-9)
    assert "grid: has cells of 50 km" in refused(path, "--spacing", "file")
    # The unit cube, which stands for an unknown box.
    volume(path, BETA, (0.0, 0.0, 0.0, 1.0, 1.0, 1.0))
    assert "extinction: has axes without names, of the lengths [4, 5, 6]; state" in refused(path, "--variable", "extinction")
    check(load(path, "--axes", "z,y,x", *STATED))
    for number, words in [((1, 1000, 1000, 1250, 1), "declares 1000 x 1000 x 1250 values"),
                          ((1, -1, 5, 4, 1), "declares -1 x 5 x 4 values"),
                          ((3, 6, 5, 4, 1), "1 channels of the type 3"), ((1, 6, 5, 4, 3), "3 channels")]:
        volume(path, BETA, (0, 0, 0, 1, 1, 1), struct.pack("<4s5i", b"VOL\x03", *number))
        assert words in refused(path)
    volume(path, BETA, (0, 0, 0, 1, -1, 1))
    assert "grid: begins at" in refused(path)
    path.write_bytes(b"VOL\x02" + bytes(100))
    assert "version 2, and version 3 is read" in refused(path)
    path.write_bytes(b"VOL\x03")
    assert "truncated or damaged" in refused(path)


def test_a_volume_that_mitsuba_wrote(tmp_path, load):
    mitsuba = pytest.importorskip("mitsuba")
    mitsuba.set_variant("scalar_rgb")
    path = tmp_path / "cloud.vol"
    mitsuba.VolumeGrid(BETA.astype("f4")[..., None]).write(str(path))
    check(load(path, "--axes", "z,y,x", *STATED))


# VTK


def image_data(path, values, **attributes):
    nz, ny, nx = values.shape
    given = {"origin": "0 0 520", "spacing": "50 60 40", "more": "", "field": "", "encoding": "raw", **attributes}
    path.write_bytes(
        f"""<?xml version="1.0"?>
<VTKFile type="ImageData" version="1.0" byte_order="BigEndian" header_type="UInt32"{given["more"]}>
  <ImageData WholeExtent="0 {nx} 0 {ny} 0 {nz}" Origin="{given["origin"]}" Spacing="{given["spacing"]}">
    <Piece Extent="0 {nx} 0 {ny} 0 {nz}">
      <PointData></PointData>
      <CellData Scalars="beta">
        <DataArray type="Float64" Name="beta" format="appended" RangeMin="0" offset="0"{given["field"]}/>
      </CellData>
    </Piece>
  </ImageData>
  <AppendedData encoding="{given["encoding"]}">
   _""".encode()
        + struct.pack(">I", 8 * values.size)
        + values.astype(">f8").tobytes()
        + b"\n</AppendedData></VTKFile>"
    )


def test_image_data_of_vtk(tmp_path, load, refused):
    path = tmp_path / "cloud.vti"
    image_data(path, BETA)
    options = ("--variable", "beta", "--units", "beta=km-1", "--spacing", "file")
    check(load(path, *options))
    for attributes, words in [
        ({"more": ' compressor="vtkZLibDataCompressor"'}, "has compressed values"),
        ({"encoding": "base64"}, "not appended in raw form"),
        ({"spacing": "50 0 40"}, "grid: begins at"),
        ({"spacing": '50 60 40" Direction="0 1 0 1 0 0 0 0 1'}, "axes that are turned"),
    ]:
        image_data(path, BETA, **attributes)
        assert words in refused(path, *options)
    image_data(path, BETA)
    path.write_bytes(path.read_bytes().replace(b"0 6 0 5 0 4", b"0 1000 0 1000 0 1250"))
    assert "has 1000 x 1000 x 1250 values, but the file has" in refused(path, *options)


@pytest.mark.parametrize("simple", [True, False])
def test_image_data_that_vtk_wrote(tmp_path, load, refused, simple):
    vtk = pytest.importorskip("vtk")
    image = vtk.vtkImageData()
    image.SetDimensions(7, 6, 5)
    image.SetSpacing(50, 60, 40)
    image.SetOrigin(0, 0, 520)
    values = vtk.vtkDoubleArray()
    values.SetName("beta")
    for value in BETA.ravel():
        values.InsertNextValue(value)
    image.GetCellData().SetScalars(values)
    writer = vtk.vtkXMLImageDataWriter()
    path = tmp_path / "cloud.vti"
    writer.SetFileName(str(path))
    writer.SetInputData(image)
    if simple:
        writer.SetDataModeToAppended()
        writer.EncodeAppendedDataOff()
        writer.SetCompressorTypeToNone()
    writer.Write()
    options = ("--variable", "beta", "--units", "beta=km-1", "--spacing", "file")
    if simple:
        check(load(path, *options))
    else:
        assert "not appended in raw form, which are not read; write it with vtkXMLImage" in refused(path, *options)


# Any change of a byte


def written(folder):
    """A file of each format, with the name of its array."""
    values = BETA.astype("f4")
    np.save(folder / "beta.npy", values)
    np.savez(folder / "a.npz", beta=values, x=np.arange(6.0))
    np.savez_compressed(folder / "b.npz", beta=values)
    image_data(folder / "a.vti", values)
    volume(folder / "a.vol", values, (0.0, 0.0, 0.52, 0.3, 0.3, 0.68))
    for protocol in (2, 5):
        content = {"beta": values, "n": [1, np.float64(2.0)], "f": BETA.T}
        (folder / f"{protocol}.pkl").write_bytes(pickle.dumps(content, protocol))
    try:
        from scipy.io import savemat
    except ImportError:
        pass
    else:
        for compressed in (False, True):
            content = {"s": {"a": 1.0, "b": "text"}, "beta": values, "c": np.array([[1, "x"]], object)}
            savemat(folder / f"{compressed}.mat", content, do_compression=compressed)
    return sorted(folder.iterdir())


@pytest.mark.filterwarnings("ignore:.*")
def test_no_change_of_a_byte_ends_the_program(tmp_path):
    """Damaged files give a cloud with finite values, or an error: never a panic."""
    chance = np.random.default_rng(5)
    for path in written(tmp_path):
        whole = path.read_bytes()
        name = "extinction" if path.suffix == ".vol" else "beta"
        axes = None if path.suffix in (".vol", ".vti") else "z,y,x"
        units = {name: "km-1"}
        if path.suffix == ".vti":
            units.update(x="m", y="m", z="m")
        options = {"variable": name, "units": units, "axes": axes, "spacing": (0.05, 0.06, 0.04)}
        assert deepct_py.import_cloud(path, **options).extinction.max() > 1.0
        read = 0
        for _ in range(400):
            changed = bytearray(whole)
            for at in chance.integers(0, min(len(whole), chance.choice([200, 1000, 10**6])), chance.integers(1, 4)):
                changed[at] = chance.choice([0, 1, 0x7F, 0x80, 0xFF, chance.integers(256)])
            path.write_bytes(changed[: chance.integers(len(whole)) if chance.random() < 0.1 else None])
            try:
                cloud = deepct_py.import_cloud(path, **options)
            except (deepct_py.DeepctError, OSError, ValueError) as problem:
                assert "\n" not in str(problem)
            else:
                assert np.isfinite(cloud.extinction).all()
                read += 1
        path.write_bytes(whole)
        assert read < 400


# deepct


@pytest.mark.filterwarnings("ignore:.*states no units")
@pytest.mark.parametrize("ending", ["npz", "mat", "vti", "vol"])
def test_converted_files_are_read_back(tmp_path, command_line, command_line_run, ending):
    """Without options and without loss: a cloud, the estimate of a network and a mask."""
    names = {name: tmp_path / f"{name}.nc" for name in ("cloud", "images", "estimate", "mask")}
    size = ("--set", "shape=[8,12,14]", "--set", "width_km=0.3", "--set", "depth_km=0.16")
    command_line("cloud", "generate", "--seed", 5, *size, "--out", names["cloud"])
    command_line("render", names["cloud"], "--views", "cloudct-10", "--samples", 2, "--out", names["images"])
    command_line("infer", names["images"], "--grid", names["cloud"], "--out", names["estimate"])
    command_line("carve", names["images"], "--grid", names["cloud"], "--out", names["mask"])
    for name in ("cloud", "estimate", "mask"):
        if ending == "vol" and name == "mask":
            continue
        there, back = tmp_path / f"there.{ending}", tmp_path / "back.nc"
        command_line("convert", names[name], there)
        command_line("convert", there, back)
        with h5py.File(names[name]) as old, h5py.File(back) as new:
            lost = {"lwc", "reff", "veff", "uncertainty"} if ending == "vol" else set()
            fields = {field for field in old if old[field].ndim == 3} - lost
            if ending == "vol":
                fields |= {"extinction"}
            assert fields == {field for field in new if new[field].ndim == 3}
            for field in fields & set(old):
                np.testing.assert_array_equal(old[field], new[field])
            for axis in "xyz":
                same = old[axis].attrs["spacing"]
                assert new[axis].attrs["spacing"] == (pytest.approx(same, rel=1e-9) if ending == "vol" else same)
                assert new[axis].attrs["lower_edge"] == pytest.approx(old[axis].attrs["lower_edge"], abs=1e-12)
        if name == "cloud":
            for file in (there, back):
                (row,) = json.loads(command_line("score", "--truth", names["cloud"], file, "--json"))
                assert row["relative_error"] == 0.0
            command_line("regrid", there, "--like", names["cloud"], "--out", tmp_path / "same.nc")
            same = deepct_py.read_cloud(names["cloud"])
            if ending != "vol":
                assert deepct_py.read_cloud(there) == same
            read = deepct_py.import_cloud(there, spacing="file")
            assert read.grid.spacing == pytest.approx(same.grid.spacing, rel=1e-9)
            np.testing.assert_allclose(read.extinction, same.extinction, rtol=1e-6)
    if ending in ("npz", "mat"):
        images = tmp_path / f"images.{ending}"
        command_line("convert", names["images"], images)
        with pytest.raises(subprocess.CalledProcessError) as failure:
            command_line_run("convert", images, tmp_path / "images2.nc")
        assert "holds images, which are not read from this format; give the netCDF file" in failure.value.stderr
