"""The example in the README runs without changes."""

import pathlib
import re


def test_the_example_of_the_readme():
    readme = pathlib.Path(__file__).parents[3] / "README.md"
    (example,) = re.findall(r"```python\n(.*?)```", readme.read_text(), flags=re.S)
    names = {}
    exec(compile(example, str(readme), "exec"), names)
    assert names["estimate"].shape == names["cloud"].grid.shape
    assert (names["estimate"] >= 0.0).all() and names["estimate"].max() > 1.0
