"""Estimates of fields that are larger than the memory, as dask arrays."""

from ._deepct import Network, Observation, Views, carve as carve_mask, grid_from

_PIXELS = (("row", "target_row"), ("col", "target_col"))


def infer(images, network="general", *, grid=None, carve=False, side=512):
    """Estimate the extinction in images, which may be larger than the memory.

    The result for a data set is computed tile by tile when it is needed, on any scheduler of dask, such as a
    cluster of ``dask.distributed``. That for an ``Observation`` is the one of ``Network.estimate``.

    Parameters
    ----------
    images : xarray.Dataset or Observation
        The variables of a file of images, which xarray has opened; all images have the same size. Without
        ``chunks``, each tile reads its own part of the file, which is faster on a cluster than chunks that
        its workers exchange. Or images in memory.
    network : Network, str or path
        The network, or its weights.
    grid : Grid, object or path, optional
        Grid of the estimate: a ``Grid``, an object or a file that has one. By default, that of the network
        for these images.
    carve : bool
        Set the extinction to zero outside of the mask that the images permit.
    side : int
        Number of rows and columns of a tile.

    Returns
    -------
    xarray.Dataset or Estimate
        ``extinction`` and ``uncertainty`` (1/km) on ``z``, ``y``, ``x`` as dask arrays; for an
        ``Observation``, an ``Estimate``.

    Raises
    ------
    ImportError
        dask or xarray is not installed.
    TypeError
        The images are neither a data set nor an observation.
    ValueError, DeepctError
        As ``Network.estimate``; those of a tile are raised when it is computed.

    Notes
    -----
    A field is computed and written by ::

        images = xarray.open_dataset("images.nc")
        deepct_py.infer(images).to_zarr("volume.zarr")
    """
    if not isinstance(network, Network):
        network = Network.load(network)
    if isinstance(images, Observation):
        return _in_memory(images, network, grid, carve)
    if not hasattr(images, "data_vars"):
        raise TypeError(
            f"images must be a data set of xarray or an Observation, not {type(images)}: open a file with "
            "xarray.open_dataset(path), or read it with deepct_py.read_images(path)"
        )
    import dask
    import dask.array
    import xarray

    images = _with_targets(images)
    corner = _corner(images)
    views, lineage = _views(images, corner), corner.lineage.then("infer")
    grid = network.grid(views) if grid is None else grid_from(grid)
    names = ("extinction", "uncertainty") if "uncertainty" in network.metadata["outputs"] else ("extinction",)
    # The weights travel to each worker once.
    shared = dask.delayed(network)
    rows = {}
    for (first, end), (left, right), around, pixels in network.tiles(views, grid, side):
        shape = (grid.shape[0], end - first, right - left)
        if pixels is None:
            tile = [dask.array.zeros(shape, dtype="f4", chunks=shape) for _ in names]
        else:
            (south, north), (west, east) = pixels
            part = images.isel(row=slice(south, north), col=slice(west, east))
            offset = _offset(grid, around)
            inner = (slice(None),) + tuple(
                slice(start - skipped, stop - skipped)
                for (start, stop), skipped in zip(((first, end), (left, right)), offset)
            )
            estimate = dask.delayed(_estimate, nout=len(names))(shared, part, around, inner, carve, names)
            tile = [dask.array.from_delayed(array, shape, dtype="f4") for array in estimate]
        rows.setdefault(first, []).append(tile)
    attributes = {"units": "km-1"}
    coordinates = {name: (name, getattr(grid, name), {"units": "km"}) for name in ("z", "y", "x")}
    if lineage.time is not None:
        of_time = {"units": lineage.units, "calendar": lineage.calendar}
        coordinates["time"] = ((), lineage.time, {name: text for name, text in of_time.items() if text})
    return xarray.Dataset(
        {
            name: (
                ("z", "y", "x"),
                dask.array.block([[tile[number] for tile in row] for row in rows.values()]),
                attributes,
            )
            for number, name in enumerate(names)
        },
        coords=coordinates,
        attrs={"history": lineage.history},
    )


def _in_memory(images, network, grid, carve):
    """The estimate from images in memory."""
    if carve and grid is None:
        grid = network.grid(images.views)
    mask = carve_mask(images, grid=grid) if carve else None
    return network.estimate(images, grid=grid, mask=mask)


def _estimate(network, images, around, inner, carved, names):
    """The estimate in a tile, and its uncertainty if there is one."""
    observation = Observation.from_dataset(images.compute())
    mask = carve_mask(observation, grid=around) if carved else None
    estimate = network.estimate(observation, grid=around, mask=mask)
    return [getattr(estimate, name)[inner] for name in names]


def _offset(grid, part):
    """The rows and columns of a grid before a part of it."""
    along = (round((part.origin[axis] - grid.origin[axis]) / grid.spacing[axis]) for axis in (1, 0))
    return tuple(along)


def _with_targets(images):
    """Images whose parts tell which pixel shows the target."""
    for axis, target in _PIXELS:
        size = images.sizes[axis]
        if axis not in images.coords:
            images = images.assign_coords({axis: range(size)})
        ends = {int(images[axis][0]), int(images[axis][-1])}
        if target not in images and ends == {0, size - 1}:
            centre = [0.5 * (size - 1)] * images.sizes["view"]
            images = images.assign({target: ("view", centre)})
    return images


def _corner(images):
    """Four pixels of images, the others of which are not read."""
    return Observation.from_dataset(images.isel(row=slice(0, 2), col=slice(0, 2)).compute())


def _views(images, corner):
    """The views of images."""
    first, size = [], []
    for axis, _ in _PIXELS:
        size.append(images.sizes[axis])
        # Rows from the north are turned around.
        reversed_ = size[-1] > 1 and images[axis][1] < images[axis][0]
        first.append(size[-1] - min(2, size[-1]) if reversed_ else 0)
    return Views([view.enlarged(first, size) for view in corner.views])
