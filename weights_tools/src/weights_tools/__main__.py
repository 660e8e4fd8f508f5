"""The command line: ``weights_tools VERB``, with the verbs ``generate``, ``distribute``, ``train``,
``scenes``, ``pack``, ``adapt``, ``calibrate``, ``baselines``, ``export`` and ``check``."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import weights_tools
from weights_tools.errors import InputError

if TYPE_CHECKING:
    from weights_tools.cluster import Program

# The modules of each command are imported when it runs, as a machine for training may not have the
# packages that the other commands require.


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command. Returns 0 on success, 1 if ``check`` finds a difference or ``adapt`` no better
    weights, 2 on an error."""
    options = _parser().parse_args(arguments)
    try:
        return options.run(options)
    except InputError as problem:
        print(f"weights_tools: {problem}", file=sys.stderr)
    except OSError as problem:
        print(f"weights_tools: {problem}; check the path and the disk", file=sys.stderr)
    return 2


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="weights_tools", description=weights_tools.__doc__)
    version = f"weights_tools {weights_tools.__version__}"
    parser.add_argument("--version", action="version", version=version)
    verbs = parser.add_subparsers(required=True, metavar="VERB")

    make = verbs.add_parser("generate", help="run `deepct dataset generate` on a dask cluster")
    make.add_argument("recipe", type=Path, help="TOML file of `deepct dataset`, see recipes/")
    make.add_argument(
        "--simulations", type=Path, default=Path(), help="folder (default: current folder)"
    )
    make.add_argument("--out", type=Path, required=True, help="folder of the dataset")
    make.add_argument("--shares", type=_count, help=_SHARES)
    _add_cluster(make)
    make.set_defaults(run=_generate)

    spread = verbs.add_parser(
        "distribute",
        help="run any command of deepct on a dask cluster",
        usage="weights_tools distribute [options] -- VERB ...",
        allow_abbrev=False,
        description="Run `deepct VERB ...` in shares, which `experiment` and `dataset generate` have, "
        "and then as a whole; or, with --files, once for each file as its only input.",
    )
    spread.add_argument("--shares", type=_count, help=_SHARES)
    spread.add_argument("--files", type=Path, nargs="+", help="files, each the input of a task")
    spread.add_argument("--out-dir", type=Path, help="folder of a file of the same name for each")
    _add_cluster(spread)
    spread.add_argument("words", nargs="+", metavar="VERB ...", help="command of deepct")
    spread.set_defaults(run=_distribute)

    train = verbs.add_parser("train", help="train a network, or resume an interrupted training")
    train.add_argument("recipe", type=Path, help="TOML file, see recipes/")
    source = train.add_mutually_exclusive_group(required=True)
    source.add_argument("--dataset", type=Path, help="folder of `deepct dataset`")
    source.add_argument(
        "--simulations", type=Path, help="folder of simulations, for a general network"
    )
    train.add_argument("--out", type=Path, required=True, help="folder of checkpoints and curves")
    train.add_argument(
        "--start",
        type=Path,
        help="checkpoint with the initial parameters, or a weights file, also of fewer bands",
    )
    train.add_argument("--minutes", type=_positive, help="maximum total duration of the training")
    train.add_argument("--threads", type=_count, help="CPU threads of each process (default: all)")
    general = train.add_argument_group("general networks")
    general.add_argument(
        "--further", type=_positive, metavar="MINUTES", help="duration in addition to that so far"
    )
    general.add_argument("--pool", type=Path, help="folder of the scenes (default: OUT/pool)")
    general.add_argument(
        "--generators", type=int, default=1, help="processes that make scenes (default: 1)"
    )
    _add_renderer(general)
    train.set_defaults(run=_train)

    scenes = verbs.add_parser("scenes", help="make scenes for the training of a general network")
    scenes.add_argument("recipe", type=Path, help="TOML file of a general network")
    scenes.add_argument("--simulations", type=Path, required=True, help="folder of simulations")
    scenes.add_argument("--out", type=Path, required=True, help="folder of the pool")
    scenes.add_argument(
        "--part", type=_part, default=(0, 1), metavar="I/N", help="generator I of N, from 0"
    )
    scenes.add_argument("--chunks", type=_count, help="end after this number of files")
    scenes.add_argument("--parent", type=int, help="end when this process has ended")
    _add_renderer(scenes)
    scenes.set_defaults(run=_scenes)

    pack = verbs.add_parser("pack", help="all that a training on another machine needs")
    pack.add_argument("recipe", type=Path, help="TOML file of a general network")
    pack.add_argument("--simulations", type=Path, required=True, help="folder of simulations")
    pack.add_argument("--out", type=Path, required=True, help="new folder")
    pack.add_argument("--start", type=Path, help="checkpoint with the initial parameters")
    pack.add_argument("--small", action="store_true", help="for `run.sh MINUTES OUT --small` only")
    pack.set_defaults(run=_pack)

    tune = verbs.add_parser(
        "adapt", help="fine-tune a network on images alone, without known clouds"
    )
    tune.add_argument("weights", help="weights file, or the name of built-in weights")
    tune.add_argument("images", type=Path, nargs="+", help="files of images, one for each scene")
    tune.add_argument("--out", type=Path, required=True, help="weights file to write")
    tune.add_argument(
        "--minutes", type=_positive, default=10.0, help="maximum duration (default: 10)"
    )
    tune.add_argument(
        "--held-out",
        type=_share,
        default=0.2,
        metavar="SHARE",
        help="share of the views of each scene that judge the result (default: 0.2)",
    )
    tune.add_argument("--threads", type=_count, help="CPU threads of PyTorch (default: all)")
    tune.add_argument("--seed", type=int, default=1, help="seed of all choices (default: 1)")
    tune.set_defaults(run=_adapt)

    adjust = verbs.add_parser(
        "calibrate", help="correct the expected error of a general network by that found"
    )
    adjust.add_argument("weights", type=Path, help="weights file of a general network")
    adjust.add_argument("--pool", type=Path, required=True, help="folder of a training's scenes")
    adjust.add_argument("--out", type=Path, required=True, help="weights file to write")
    adjust.set_defaults(run=_calibrate)

    trivial = verbs.add_parser("baselines", help="scores of estimates without a network")
    trivial.add_argument("recipe", type=Path, help="TOML file that gives the views and the noise")
    trivial.add_argument("--dataset", type=Path, required=True, help="folder of `deepct dataset`")
    trivial.add_argument("--deepct", default="deepct", help="the program (default: on the PATH)")
    trivial.set_defaults(run=_baselines)

    convert = verbs.add_parser("export", help="convert a checkpoint or state dict to weights")
    convert.add_argument("checkpoint", type=Path)
    convert.add_argument("--out", type=Path, required=True, help="NAME.safetensors or NAME.onnx")
    convert.add_argument(
        "--metadata",
        type=Path,
        help="JSON with metadata to add or replace; batch normalisation with another epsilon than "
        '1e-5 requires {"configuration": {"batch_norm_epsilon": EPSILON}}, and convolutions are '
        "taken to pad with zeros",
    )
    convert.add_argument(
        "--like",
        metavar="WEIGHTS",
        help="built-in weights whose views, Sun and levels are those of a bare state dict, such as "
        "cloudct-10; its input is taken to be radiance (1/sr) and its output extinction (1/km), "
        "unless --metadata has other scales",
    )
    convert.add_argument(
        "--unbiased",
        type=_share,
        nargs="?",
        const=1.0,
        default=0.0,
        metavar="SHARE",
        help="remove this share (0 to 1) of the mean delta of the scores (without a number: 1); "
        "the file then has the scores of the original scale as epsilon_biased and delta_biased",
    )
    convert.add_argument(
        "--extremes",
        action="store_true",
        help="extend a general network by the minimum and maximum over the views, unused at first",
    )
    convert.set_defaults(run=_export)

    compare = verbs.add_parser(
        "check", help="compare `deepct infer`, or the ONNX runtimes installed, with PyTorch"
    )
    compare.add_argument("checkpoint", type=Path)
    compare.add_argument("--weights", type=Path, required=True, help="the exported weights file")
    compare.add_argument("--deepct", default="deepct", help="the program (default: on the PATH)")
    compare.add_argument("--seed", type=int, default=1, help="seed of the random images")
    compare.set_defaults(run=_check)
    return parser


def _add_renderer(parser: argparse._ActionsContainer) -> None:
    parser.add_argument(
        "--renderer",
        choices=("auto", "ordinates", "monte-carlo", "photon-paths"),
        default="auto",
        help="solver of deepct_py, or the Monte Carlo program of this package (default: the latter "
        "on a GPU and without deepct_py, otherwise ordinates)",
    )
    parser.add_argument(
        "--paths", type=_count, default=1024, help="photon paths of a pixel (default: 1024)"
    )
    parser.add_argument("--small", action="store_true", help="few small scenes, for a test")


def _part(text: str) -> tuple[int, int]:
    number, _, count = text.partition("/")
    part = int(number), int(count)
    if not 0 <= part[0] < part[1]:
        raise argparse.ArgumentTypeError(f"{text} is not I/N with I from 0 to N - 1")
    return part


def _positive(text: str) -> float:
    value = float(text)
    if not 0.0 < value < float("inf"):
        raise argparse.ArgumentTypeError(f"{text} is not a positive number")
    return value


def _share(text: str) -> float:
    number = float(text)
    if not 0.0 <= number <= 1.0:
        raise argparse.ArgumentTypeError(f"{text} is not from 0 to 1")
    return number


def _count(text: str) -> int:
    value = int(text)
    if value < 1:
        raise argparse.ArgumentTypeError(f"{text} is less than 1")
    return value


_SHARES = "number of parts (default: four for each thread)"


def _add_cluster(verb: argparse.ArgumentParser) -> None:
    verb.add_argument(
        "--cluster", metavar="ADDRESS", help="dask scheduler (default: a local cluster)"
    )
    verb.add_argument(
        "--workers", type=_count, help="workers of the local cluster (default: all cores)"
    )
    verb.add_argument("--deepct", default="deepct", help="the program (default: on the PATH)")


@contextmanager
def _program(options: argparse.Namespace) -> Iterator[Program]:
    """The program on the cluster that the options name."""
    try:
        from weights_tools.cluster import Program, cluster
    except ModuleNotFoundError as problem:
        remedy = "install it with `pip install distributed`"
        raise InputError("cluster", f"{problem.name} is missing", remedy) from None
    with cluster(options.cluster, options.workers) as client:
        yield Program(client, partial(print, flush=True), options.deepct)


def _generate(options: argparse.Namespace) -> int:
    with _program(options) as program:
        from weights_tools.generate import Order, generate

        order = Order(options.recipe, options.simulations, options.out)
        generate(order, program, options.shares)
    return 0


def _distribute(options: argparse.Namespace) -> int:
    if (options.files is None) != (options.out_dir is None):
        raise InputError("distribute", "needs --files and --out-dir together", "give both")
    if options.files and options.shares:
        raise InputError("--shares", "is for commands without --files", "leave it out")
    with _program(options) as program:
        if options.files:
            program.for_files(options.words, options.files, options.out_dir)
        else:
            print(program.in_shares(options.words, options.shares), end="")
    return 0


def _train(options: argparse.Namespace) -> int:
    import torch

    from weights_tools.general_recipe import is_general_recipe

    if options.threads is not None:
        torch.set_num_threads(options.threads)
    if is_general_recipe(options.recipe):
        return _train_general(options)
    if options.dataset is None:
        remedy = "give --dataset instead"
        raise InputError("--simulations", "is for recipes of general networks", remedy)
    from weights_tools.dataset import load_dataset
    from weights_tools.distributed import processes
    from weights_tools.recipe import load_recipe
    from weights_tools.training import Training

    recipe = load_recipe(options.recipe)
    radius = recipe.network.effective_radius
    data = load_dataset(options.dataset, recipe.formation, effective_radius=radius)
    with processes() as ours:
        report = partial(print, flush=True) if ours.first else lambda line: None
        training = Training(recipe, data, options.out, ours, options.start)
        by = f"{ours.device}" if ours.count == 1 else f"{ours.count} x {ours.device.type}"
        report(
            f"{len(data.train)} training and {len(data.validation)} validation clouds, "
            f"{len(data.geometry)} views, channels {training.network.channels}, on {by}"
        )
        training.run(options.minutes, report)
    return 0


def _train_general(options: argparse.Namespace) -> int:
    import torch

    from weights_tools.general_training import GeneralTraining, Generators

    if options.simulations is None:
        remedy = "give --simulations instead"
        raise InputError("--dataset", "is for recipes of one formation", remedy)
    recipe = _general_recipe(options)
    device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
    generators = Generators(
        options.recipe,
        options.simulations,
        options.generators,
        options.renderer,
        options.paths,
        options.small,
        options.pool,
    )
    report = partial(print, flush=True)
    training = GeneralTraining(recipe, options.out, generators, device, report, options.start)
    minutes = options.minutes or recipe.training.minutes
    if options.further is not None:
        minutes = training.elapsed_s / 60.0 + options.further
    training.run(minutes)
    return 0


def _general_recipe(options: argparse.Namespace) -> Any:
    from weights_tools.general_recipe import load_general_recipe
    from weights_tools.general_training import small

    recipe = load_general_recipe(options.recipe)
    return small(recipe) if options.small else recipe


def _scenes(options: argparse.Namespace) -> int:
    from weights_tools.renderers import renderer_of
    from weights_tools.stream import generate

    recipe = _general_recipe(options)
    paths = 8 if options.small else options.paths
    renderer = renderer_of(options.renderer, paths)
    lines = generate(recipe, options.simulations, options.out, renderer, options.part)
    for number, line in enumerate(lines, 1):
        print(line, flush=True)
        ended = options.parent is not None and os.getppid() != options.parent
        if ended or number == options.chunks:
            break
    return 0


def _pack(options: argparse.Namespace) -> int:
    from weights_tools.pack import pack

    recipe = _general_recipe(options)
    for line in pack(recipe, options.recipe, options.simulations, options.out, options.start):
        print(line, flush=True)
    return 0


def _adapt(options: argparse.Namespace) -> int:
    import torch

    try:
        import deepct_py  # noqa: F401

        from weights_tools.adapt import Settings, adapt
    except ModuleNotFoundError as problem:
        remedy = "install deepct_py"
        raise InputError("adapt", f"{problem.name} is missing", remedy) from None
    if options.threads is not None:
        torch.set_num_threads(options.threads)
    settings = Settings(minutes=options.minutes, held_out=options.held_out, seed=options.seed)
    report = partial(print, flush=True)
    return 0 if adapt(options.weights, options.images, options.out, settings, report) else 1


def _calibrate(options: argparse.Namespace) -> int:
    from weights_tools.calibrate import calibrate

    calibrate(options.weights, options.pool, options.out, print)
    return 0


def _baselines(options: argparse.Namespace) -> int:
    from weights_tools.baselines import baselines
    from weights_tools.dataset import load_dataset
    from weights_tools.recipe import load_recipe

    recipe = load_recipe(options.recipe)
    data = load_dataset(options.dataset, recipe.formation)
    answers = baselines(data, recipe.training.seed, recipe.sensor, options.deepct)
    for name, (epsilon, delta) in answers.items():
        print(f"epsilon {epsilon:7.4f}  delta {delta:+7.4f}  {name}")
    return 0


def _export(options: argparse.Namespace) -> int:
    from weights_tools.export import export, is_onnx, merge, metadata_like, read_metadata
    from weights_tools.general_file import export_general, is_general

    changes = read_metadata(options.metadata) if options.metadata else {}
    if options.like:
        changes = merge(metadata_like(options.like, options.checkpoint), changes)
        scales = f"input_scale {changes['input_scale']:g}, output_scale {changes['output_scale']:g}"
        print(f"as {options.like}: {scales} (--metadata states others)")
    order = options.checkpoint, options.out, changes, options.unbiased
    if not is_onnx(options.out) and is_general(options.checkpoint):
        lines = export_general(*order, options.extremes)
    elif options.extremes:
        remedy = "leave --extremes out"
        raise InputError(options.checkpoint, "is not of a general network", remedy)
    else:
        lines = export(*order)
    for line in (f"wrote {options.out}", *lines):
        print(line)
    return 0


def _check(options: argparse.Namespace) -> int:
    from weights_tools.check import SIZES, check, engines

    same = True
    for engine in engines(options.weights, options.deepct):
        if engine.settings:
            print(f"{engine.name} with {engine.settings}")
        errors = check(options.checkpoint, options.weights, engine, options.seed)
        for (rows, cols), error in zip(SIZES, errors):
            verdict = "same" if error <= engine.tolerance else "DIFFERENT"
            print(f"{rows:4d} x {cols:<4d} {engine.name:<12} error {error:.1e}  {verdict}")
        same = same and max(errors) <= engine.tolerance
    return 0 if same else 1


if __name__ == "__main__":
    sys.exit(main())
