"""The pages of `deepct view` and `deepct report` in a browser."""

import html
import re
import webbrowser

import numpy as np
import pytest
from browser import CHROMIUM, examine

import deepct_py

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="there is no chromium on the PATH")

# What a script sees: the pictures of the 3D views and of the slices, and their numbers of colours.
LOOK = """
const set = (id, value) => {
  const control = document.getElementById(id);
  if (control.type === 'checkbox') control.checked = value; else control.value = value;
  control.dispatchEvent(new Event('input'));
};
const still = async () => {
  await new Promise(resolve => setTimeout(resolve, 300));
  for (let count = 0; count < 3; count++) await frame();
};
const pixelsOf = canvas =>
  canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height).data;
const look = async kind => {
  await still();
  return [...document.querySelectorAll('canvas.' + kind)].map(pixelsOf);
};
// Whether pictures differ by more than the edges of lines, which are not always drawn alike.
const differ = (one, other) => {
  if (one.length !== other.length) return true;
  let count = 0;
  for (let index = 0; index < one.length; index++) count += Math.abs(one[index] - other[index]) > 40;
  return count > 5e-4 * one.length;
};
const colours = kind => [...document.querySelectorAll('canvas.' + kind)].map(canvas =>
  new Set(new Uint32Array(pixelsOf(canvas).buffer)).size);
"""


@pytest.fixture(scope="module")
def volumes(tmp_path_factory):
    """A truth and an estimate with its uncertainty; the cloud is in the north-east."""
    folder = tmp_path_factory.mktemp("pages")
    grid = deepct_py.Grid(shape=(8, 12, 10), spacing=(0.1, 0.05, 0.05), origin=(0.0, 0.0, 0.5))
    z, y, x = np.meshgrid(grid.z, grid.y, grid.x, indexing="ij")
    inside = (x > 0.3) & (y > 0.3) & (z > 0.6) & (z < 0.8)
    truth = np.where(inside, 20.0 + 100.0 * x, 0.0).astype(np.float32)
    estimate = (0.8 * truth).astype(np.float32)
    deepct_py.Estimate(grid, truth).to_netcdf(folder / "truth.nc")
    deepct_py.Estimate(grid, estimate, 0.1 * estimate).to_netcdf(folder / "estimate.nc")
    return folder, grid, truth


@pytest.fixture(scope="module")
def page(volumes, command_line):
    folder, _, _ = volumes
    out = folder / "page.html"
    printed = command_line("view", folder / "estimate.nc", "--truth", folder / "truth.nc", "--out", out)
    assert printed.strip() == str(out)
    return out


def test_every_control_changes_the_picture(page):
    found = examine(page, LOOK + """
      const changes = {};
      let before = { view: await look('view'), slice: await look('slice') };
      const shown = { view: colours('view'), slice: colours('slice') };
      const note = async name => {
        const after = { view: await look('view'), slice: await look('slice') };
        changes[name] = ['view', 'slice'].map(kind =>
          after[kind].map((picture, number) => differ(picture, before[kind][number])));
        before = after;
      };
      const send = event => document.querySelector('canvas.view').dispatchEvent(event);
      const start = before.view;
      send(new PointerEvent('pointermove', { buttons: 1, movementX: 40, movementY: 10 }));
      await note('drag');
      send(new WheelEvent('wheel', { deltaY: 200 }));
      await note('wheel');
      send(new KeyboardEvent('keydown', { key: 'ArrowLeft' }));
      await note('key');
      document.getElementById('reset').click();
      await note('reset');
      const isBack = !before.view.some((picture, number) => differ(picture, start[number]));
      set('threshold', 55);
      await note('threshold');
      set('threshold', 0);
      await note('no threshold');
      set('axis', 'y');
      await note('axis');
      set('position', 2);
      await note('position');
      set('position', 9);
      await note('position in the cloud');
      set('cut', true);
      await note('cut');
      const fields = [...document.getElementById('field').options].map(option => option.text);
      for (let number = 1; number < fields.length; number++) {
        set('field', number);
        await note(fields[number]);
      }
      return { problems, shown, changes, isBack, fields,
        webgl: document.getElementById('no-webgl').hidden };
    """)
    assert found["problems"] == []
    assert found["webgl"] and found["isBack"]
    assert found["fields"] == ["cloud in sunlight", "extinction", "difference", "uncertainty"]
    assert len(found["shown"]["view"]) == len(found["shown"]["slice"]) == 2
    assert min(found["shown"]["view"] + found["shown"]["slice"]) > 20
    both, neither = [True, True], [False, False]
    for control in ("drag", "wheel", "key", "reset", "threshold", "no threshold", "cut"):
        assert found["changes"][control] == [both, neither], control
    for control in ("axis", "position", "position in the cloud"):
        assert found["changes"][control] == [neither, both], control
    for field in found["fields"][1:]:
        # The truth stays beside the difference.
        assert found["changes"][field][0][1], field


def test_slices_have_the_values_of_the_file(page, volumes):
    """A slice is a map with north at the top, and its reading is the value of the voxel there."""
    _, grid, truth = volumes
    level, row, column = 3, 10, 8
    found = examine(page, LOOK + f"""
      set('field', 1);
      set('axis', 'z');
      set('position', {level});
      await still();
      const slice = document.querySelector('canvas.slice');
      const readings = [];
      for (let y = 0; y < slice.clientHeight; y += 4) for (let x = 0; x < slice.clientWidth; x += 4) {{
        const event = new PointerEvent('pointermove', {{ clientX: 0, clientY: 0 }});
        Object.defineProperty(event, 'offsetX', {{ value: x }});
        Object.defineProperty(event, 'offsetY', {{ value: y }});
        slice.dispatchEvent(event);
        readings.push([x, y, document.querySelector('.reading').textContent]);
      }}
      return readings;
    """)
    readings = {text: (x, y) for x, y, text in found if text}
    assert len(readings) == 12 * 10
    place = f"x {grid.x[column]:.3f}, y {grid.y[row]:.3f}, z {grid.z[level]:.3f} km: "
    [reading] = [text for text in readings if text.startswith(place)]
    value = float(reading.removeprefix(place).split()[0])
    # One step of the stored values, and four digits of the text.
    assert value == pytest.approx(truth[level, row, column], abs=float(truth.max()) / 65535 + 5e-3)
    south_west = f"x {grid.x[0]:.3f}, y {grid.y[0]:.3f},"
    [corner] = [at for text, at in readings.items() if text.startswith(south_west)]
    x, y = readings[reading]
    assert x > corner[0] and y < corner[1]


def test_the_page_of_a_folder_has_no_errors(volumes, command_line):
    folder, _, _ = volumes
    command_line("report", folder, "--out", folder / "report.html")
    found = examine(folder / "report.html", LOOK + """
      await still();
      return { problems, views: colours('view'), text: document.body.innerText };
    """)
    assert found["problems"] == []
    assert len(found["views"]) == 2 and min(found["views"]) > 20
    # The sum of |estimate - truth| and that of truth - estimate are both a fifth of the truth.
    assert "estimate.nc\t0.2000\t0.2000" in found["text"]


def test_a_bright_voxel_does_not_darken_the_others(tmp_path):
    grid = deepct_py.Grid(shape=(8, 12, 12), spacing=(0.05, 0.05, 0.05))
    values = np.random.default_rng(1).uniform(10.0, 20.0, grid.shape).astype(np.float32)
    values[3, 4, 5] = 1000.0
    end = np.percentile(values, 99.8, method="higher")
    deepct_py.view(values, grid=grid, out=tmp_path / "page.html")
    found = examine(tmp_path / "page.html", LOOK + """
      set('field', 1);
      await still();
      return texts;
    """)
    assert 19.9 < end < 20.0
    assert "km\u207b\u00b9, largest 1000" in found and "15" in found and "20" not in found


def test_the_page_is_that_of_the_command_line(page, volumes, tmp_path, monkeypatch):
    folder, grid, truth = volumes
    expected = page.read_text(encoding="utf-8")
    estimate = deepct_py.read_volume(folder / "estimate.nc")
    made = deepct_py.view(folder / "estimate.nc", folder / "truth.nc", out=tmp_path / "page.html")
    assert made.html == expected == (tmp_path / "page.html").read_text(encoding="utf-8")
    assert deepct_py.view(estimate, truth, title="estimate.nc").html == expected
    opened = []
    monkeypatch.setattr(webbrowser, "open", opened.append)
    path = made.open()
    assert opened == [path.as_uri()] and path.read_text(encoding="utf-8") == expected
    path.unlink()
    (tmp_path / "letter.html").write_text("Dear colleague,")
    with pytest.raises(FileExistsError):
        made.save(tmp_path / "letter.html")
    with pytest.raises(ValueError, match="ending in .html"):
        made.save(tmp_path / "page.htm")
    with pytest.raises(ValueError, match="grid"):
        deepct_py.view(estimate, truth[1:])


def test_notebooks_show_the_view(tmp_path):
    """Below the table is the page in a frame, which is small, with averages of large fields."""
    cloud = deepct_py.generate_cloud(seed=3, shape=(32, 64, 64))
    estimate = deepct_py.Estimate(cloud.grid, cloud.extinction, 0.1 * cloud.extinction)
    carved = deepct_py.Carved(cloud.grid, cloud.extinction > 0)
    large = deepct_py.Estimate(
        deepct_py.Grid((64, 128, 128), (0.025, 0.025, 0.02)),
        np.repeat(np.repeat(np.repeat(cloud.extinction, 2, 0), 2, 1), 2, 2))
    for number, shown in enumerate((cloud, estimate, carved, large)):
        text = shown._repr_html_()
        table, [source] = text.split("<iframe")[0], re.findall(r'srcdoc="([^"]*)"', text)
        assert f"<caption>deepct_py.{type(shown).__name__}</caption>" in table
        assert 'sandbox="allow-scripts"' in text and len(text) < 400_000
        page = tmp_path / f"{number}.html"
        page.write_text(html.unescape(source), encoding="utf-8")
        found = examine(page, LOOK + """
          await still();
          return { problems, views: colours('view'), text: document.body.innerText };
        """)
        assert found["problems"] == [] and min(found["views"]) > 20
        assert ("means over blocks of 2 x 2 x 2" in found["text"]) == (shown is large)
    assert deepct_py.view(large)._repr_html_().count("<iframe") == 1
    # What has no volume is a table alone.
    assert "<iframe" not in cloud.grid._repr_html_()


def test_the_frame_in_a_notebook_draws(tmp_path):
    """The frame may run scripts only, and tells the page around it what it has drawn."""
    cloud = deepct_py.generate_cloud(seed=3, shape=(16, 32, 32))
    tell = html.escape("""<script>
      const look = () => {
        const canvas = document.querySelector('canvas.view');
        if (!canvas) return setTimeout(look, 50);
        const pixels = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height).data;
        parent.postMessage(new Set(new Uint32Array(pixels.buffer)).size, '*');
      };
      setTimeout(look, 500);
    </script>""")
    frame = re.search("<iframe.*?srcdoc=", cloud._repr_html_(), re.S).group()
    page = html.escape(deepct_py.view(cloud).html)
    (tmp_path / "notebook.html").write_text(
        f'<html><head></head><body>{frame}"{page}{tell}"></iframe></body></html>', encoding="utf-8")
    found = examine(tmp_path / "notebook.html", """
      return new Promise(done => { window.onmessage = event => done(event.data); });
    """)
    assert found > 20
