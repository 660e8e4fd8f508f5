"""A second cloud beside a cloud: its position and that of its images."""

import torch

from weights_tools.dataset import Samples, ViewGeometry
from weights_tools.neighbours import GAP, Neighbours, moved
from weights_tools.shift import Shifter

SIZE = 24
SKY = torch.tensor([0.02, 0.03])
# A view from the zenith and one from 60 degrees to the south; pixel sizes are perpendicular to the
# line of sight.
GEOMETRY = ViewGeometry(30.0, 45.0, (0.0, 60.0), (0.0, 180.0), (0.05, 0.025), (600.0, 1000.0))


def cloud(y: int, x: int) -> tuple[torch.Tensor, torch.Tensor]:
    """A cloud of four columns, and images that are bright where they show it. A pixel is one voxel
    along y in both views; along x, it is half a voxel in the second view."""
    extinction = torch.zeros(3, SIZE, SIZE)
    extinction[1, y : y + 2, x : x + 2] = 5.0
    radiance = SKY[:, None, None].repeat(1, SIZE, SIZE)
    radiance[0, y : y + 2, x : x + 2] += 0.5
    left = SIZE // 2 + 2 * (x - SIZE // 2)
    radiance[1, y : y + 2, left : left + 4] += 0.25
    return extinction, radiance


def test_a_neighbour_stands_clear_and_its_images_are_where_it_stands():
    clouds = [cloud(11, 11), cloud(10, 12), cloud(12, 11), cloud(11, 12)]
    samples = Samples(*(torch.stack(part) for part in zip(*clouds)))
    neighbours = Neighbours(samples, Shifter(GEOMETRY, (0.05, 0.05, 0.04), 1), 1.0)
    assert torch.allclose(neighbours.sky, SKY)
    generator = torch.Generator().manual_seed(4)
    seen = 0
    for _ in range(30):
        extinction, radiance = neighbours.draw(*samples.__dict__.values(), generator)
        for index, (alone, images) in enumerate(clouds):
            added = extinction[index] - alone
            assert torch.equal(extinction[index] > 0.0, (alone > 0.0) | (added > 0.0))
            assert added.amax() <= 5.0 and (added * alone).sum() == 0.0
            bright = radiance[index] - images > 0.1
            # In the nadir view, the bright pixels are the columns of the neighbour.
            assert torch.equal(bright[0], added.amax(0) > 0.0)
            middle = slice(SIZE // 4, SIZE - SIZE // 4)
            columns = (added.amax((0, 1)) > 0.0)[middle].repeat_interleave(2)
            assert torch.equal(bright[1].any(0), columns) or not bright[0].any()
            if added.any():
                seen += 1
                lines = [
                    [part.amax((0, 2 - axis)).nonzero() for part in (alone, added)]
                    for axis in (0, 1)
                ]
                gaps = [max(b.min() - a.max(), a.min() - b.max()) - 1 for a, b in lines]
                assert GAP[0] <= max(gaps)
    assert seen > 40


def test_without_a_share_nothing_changes():
    samples = Samples(*(part[None] for part in cloud(11, 11)))
    neighbours = Neighbours(samples, Shifter(GEOMETRY, (0.05, 0.05, 0.04), 1), 0.0)
    extinction, radiance = neighbours.draw(
        samples.extinction, samples.radiance, torch.Generator().manual_seed(1)
    )
    assert torch.equal(extinction, samples.extinction)
    assert torch.equal(radiance, samples.radiance)


def test_what_leaves_is_gone_and_what_enters_is_clear():
    volume = torch.arange(1.0, 7.0).reshape(1, 2, 3)
    assert moved(volume, 1, 2).tolist() == [[[0.0, 1.0, 2.0], [0.0, 4.0, 5.0]]]
    assert moved(volume, -1, 1).tolist() == [[[4.0, 5.0, 6.0], [0.0, 0.0, 0.0]]]
    assert not moved(volume, 3, 2).any() and not moved(volume, -9, 1).any()
