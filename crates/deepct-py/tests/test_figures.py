"""Figures as PNG, SVG and PDF: the same panels and texts, read by other programs."""

import base64
import io
import xml.etree.ElementTree

import numpy as np
import pytest
from browser import CHROMIUM, examine

import deepct_py

SVG = "{http://www.w3.org/2000/svg}"
HREF = "{http://www.w3.org/1999/xlink}href"
PLACE = "x = 0.95 km"
TITLE = "Truth & estimate <of a cloud>"


@pytest.fixture(scope="module")
def figure():
    """A truth and an estimate with its uncertainty: 3 + 1 + 3 columns of three maps, and the last row."""
    grid = deepct_py.Grid(shape=(8, 12, 10), spacing=(0.1, 0.05, 0.05), origin=(0.0, 0.0, 0.5))
    z, y, x = np.meshgrid(grid.z, grid.y, grid.x, indexing="ij")
    truth = np.where((x > 0.3) & (y > 0.3) & (z > 0.6) & (z < 0.8), 20.0 + 100.0 * x, 0.0)
    estimate = deepct_py.Estimate(grid, 0.8 * truth, 0.1 * truth)
    return deepct_py.plot(estimate, truth, grid=grid, title=TITLE)


@pytest.fixture(scope="module")
def svg(figure):
    return xml.etree.ElementTree.fromstring(figure.svg)


def check_texts(texts):
    assert TITLE in texts and f"difference, {PLACE}" in texts and "voxels" in texts
    assert "estimate \u2212 truth (km\u207b\u00b9)" in texts and "\u03b5 = 0.200, \u03b4 = 0.200" in texts
    assert texts.count("altitude (km)") == 14


def test_svg_has_texts_and_maps(svg):
    check_texts([element.text for element in svg.iter(f"{SVG}text")])
    assert svg.find(f"{SVG}title").text == TITLE
    matplotlib = pytest.importorskip("matplotlib.image")
    shapes = []
    for element in svg.iter(f"{SVG}image"):
        png = base64.b64decode(element.get(HREF).removeprefix("data:image/png;base64,"))
        shapes.append(matplotlib.imread(io.BytesIO(png)).shape[:2])
    # Seven columns of sections, each with the cells of the grid.
    assert [shapes.count(shape) for shape in [(12, 10), (8, 10), (8, 12)]] == [7, 7, 7]
    assert shapes.count((75, 75)) == 1 and shapes.count((340, 340)) == 2


def test_pdf_has_texts_and_maps(figure, svg):
    pypdf = pytest.importorskip("pypdf")
    document = pypdf.PdfReader(io.BytesIO(figure.pdf), strict=True)
    [page] = document.pages
    assert document.metadata.title == TITLE
    assert page.mediabox.width == 0.5 * int(svg.get("width"))
    assert page.mediabox.height == 0.5 * int(svg.get("height"))
    texts = page.extract_text()
    assert page.extract_text(0).splitlines().count(TITLE) == 1
    for text in (f"difference, {PLACE}", "\u03b5 = 0.200, \u03b4 = 0.200", "km\u207b\u00b9"):
        assert text in texts, text
    objects = page["/Resources"]["/XObject"]
    sizes = [(value["/Height"], value["/Width"]) for value in objects.values()]
    images = [(element.get("height"), element.get("width")) for element in svg.iter(f"{SVG}image")]
    assert len(sizes) == len(images)
    assert [sizes.count(shape) for shape in [(12, 10), (8, 10), (8, 12)]] == [7, 7, 7]
    fonts = [font["/DescendantFonts"][0] for font in page["/Resources"]["/Font"].values()]
    assert all("/FontFile2" in font["/FontDescriptor"] for font in fonts)


def test_files_have_the_format_of_their_ending(figure, tmp_path):
    for name, expected in (("a.png", figure.png), ("a.svg", figure.svg.encode()), ("a.pdf", figure.pdf)):
        figure.save(tmp_path / name)
        figure.save(tmp_path / name)
        assert (tmp_path / name).read_bytes() == expected
    (tmp_path / "letter.pdf").write_bytes(b"%PDF-1.7\n%\x80\x80\x80\x80 Dear colleague,")
    with pytest.raises(FileExistsError):
        figure.save(tmp_path / "letter.pdf")


@pytest.mark.skipif(CHROMIUM is None, reason="there is no chromium on the PATH")
def test_svg_looks_like_png(figure, tmp_path):
    """A browser draws the same, but for the letters, whose font it may lack, and the edges of lines."""
    sources = {
        "png": "image/png;base64," + base64.b64encode(figure.png).decode(),
        "svg": "image/svg+xml;base64," + base64.b64encode(figure.svg.encode()).decode(),
    }
    images = "".join(f'<img id="{name}" src="data:{source}">' for name, source in sources.items())
    page = tmp_path / "page.html"
    page.write_text(f"<html><head></head><body>{images}</body></html>", encoding="utf-8")
    found = examine(page, """
      const pixels = id => {
        const image = document.getElementById(id), canvas = document.createElement('canvas');
        [canvas.width, canvas.height] = [image.naturalWidth, image.naturalHeight];
        const context = canvas.getContext('2d');
        context.drawImage(image, 0, 0);
        return [canvas.width, canvas.height, context.getImageData(0, 0, canvas.width, canvas.height).data];
      };
      const [width, height, png] = pixels('png'), [wide, high, svg] = pixels('svg');
      let count = 0, dark = 0;
      for (let at = 0; at < png.length; at++) {
        count += Math.abs(png[at] - svg[at]) > 60;
        dark += png[at] < 195;
      }
      return { sizes: [width, height, wide, high], different: count / png.length, dark: dark / png.length };
    """)
    width, height, wide, high = found["sizes"]
    assert (width, height) == (wide, high)
    assert found["dark"] > 0.1 and found["different"] < 0.01, found
