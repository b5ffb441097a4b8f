"""The command `obpose-datagen`: synthetic RGB-D scenes of objects on a table, with exact labels.

obpose-datagen --scenes 1000 --video          1000 clips of moving objects
obpose-datagen --scenes 1000                  1000 still scenes from three views
obpose-datagen verify DIR                     prove a dataset's labels
"""

import argparse
import dataclasses
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from datagen.commands import importing, options
from datagen.commands.arguments import (
    Assets,
    Constants,
    Export,
    Generate,
    Inspect,
    Preview,
    Push,
    Regenerate,
    Render,
    Stats,
    Verify,
)
from datagen.config import Recipe, recipe_names
from datagen.console.command_line import Command, run_command
from datagen.errors import EXIT_OK, EXIT_VERIFICATION, UsageError
from datagen.schema import EDITS, SIGNALS, SPLITS
from datagen.sensor_presets import with_sensor
from datagen.storage.reader import Dataset
from datagen.storage.spec import CARD_FILE, read_spec, rendered_recipe_of

if TYPE_CHECKING:
    from datagen.meshes.library import Library
    from datagen.pipeline.generate import Report

PROGRAM = "obpose-datagen"
_LOADING = """Load it:
    from datagen.storage.reader import Dataset
    scenes = Dataset("{folder}").split("{split}")
    record = scenes[0]  # a dict of arrays; scenes.read(0, ["rgb"]) reads only some
"""
_LOADING_PIXELS = """\
    rgb, labels = record["rgb"], record["segmentation"]  # frame view height width (channel)
    depth = record["depth"] * 1e-4  # metres, 0 = no return
"""
_LOADING_POSES = """\
    positions = record["poses/position"]  # frame object xyz, metres
    objects = record["objects/category"][: record["objects/count"]]
Make images of it:
    obpose-datagen render --from {folder}
"""
_RESUMED = "Interrupted; finished shards are kept, run the same command again to continue."
_INTERRUPTED = {
    "generate": _RESUMED,
    "render": _RESUMED,
    "import": "Interrupted; nothing was imported.",
    "export": "Interrupted; nothing was exported.",
    "assets": "Interrupted; no sheet was written. Hulls of finished meshes are kept, run the same command again.",
}
"""Messages after Ctrl-C, which say what remains, by subcommand."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code."""
    given = sys.argv[1:] if arguments is None else arguments
    name = given[0] if given and given[0] in COMMANDS else "generate"
    kept = _INTERRUPTED.get(name, "Interrupted.")
    return run_command(PROGRAM, COMMANDS, default="generate", arguments=arguments, interrupted=kept)


def _default_generate(arguments: list[str]) -> dict[str, Any]:
    """Find the recipe before parsing the other flags, because its values are the defaults of the constants' flags."""
    parser = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    parser.add_argument("--recipe")
    parser.add_argument("--video", action="store_true")
    parser.add_argument("--sensor-preset")
    known, _ = parser.parse_known_args(arguments)
    recipe = options.choose_recipe(known.recipe, video=known.video)
    recipe = with_sensor(recipe, known.sensor_preset) if known.sensor_preset else recipe
    recipe = options.with_overrides(recipe, arguments)
    values = Generate(recipe=known.recipe, sensor_preset=known.sensor_preset, constants=Constants.of(recipe))
    return {"default": values, "description": _description(recipe)}


def _description(recipe: Recipe) -> str:
    """Text shown above the flags in --help. The help printer drops single line breaks, so use empty lines."""
    return "\n\n".join(
        [
            "Synthetic RGB-D scenes of objects on a table, with exact labels.",
            "--scenes 1000 --video: 1000 clips of moving objects. --scenes 1000: 1000 still scenes from three views.",
            f"Subcommands, each with a --help of its own: {', '.join(COMMANDS)}; without one, generate.",
            f"Recipes: {', '.join(recipe_names())}. Defaults below are those of {recipe.name}.",
        ]
    )


def _default_render(arguments: list[str]) -> dict[str, Any]:
    parser = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    parser.add_argument("--from", dest="source")
    known, _ = parser.parse_known_args(arguments)
    if not known.source:
        return {}
    recipe = rendered_recipe_of(read_spec(Path(known.source)))
    return {"default": Render(source=Path(known.source), rig=recipe.rig, views=recipe.views)}


def _generate(values: Generate) -> int:
    # Flags, checked before slow libraries are loaded.
    options.check_seed(values.seed)
    splits = options.parse_splits(values.scenes, values.split)
    recipe = values.constants.recipe()
    if values.video and not recipe.video:
        raise UsageError("--video contradicts --frames 1; leave one of them out.")
    edits = options.parse_names("--edits", values.edits, EDITS)
    signals = options.parse_names("--with", values.signals, SIGNALS)
    other = values.compression if values.compression != "gzip" else None
    of_images = {"--resolution": values.resolution, "--renderer": values.renderer, "--edits": edits, "--with": signals}
    # Flags that belong to images.
    if values.simulate_only:
        for flag in (flag for flag, given in {**of_images, "--compression": other}.items() if given):
            raise UsageError(f"--simulate-only makes no images; give {flag} to `render` instead.")
    cameras = _cameras(values.cameras)
    size = None
    if not values.simulate_only:
        default = cameras.resolution if cameras else recipe.resolution
        size = options.parse_resolution(values.resolution) if values.resolution else default
    folder = values.out or options.default_folder(recipe.name, size, values.seed)
    run = _how(values)

    from datagen.pipeline.generate import generate

    _announce_compilation()
    renderer = None if values.simulate_only else values.renderer or "raster"
    meshes = _meshes(values, recipe)
    settings: dict[str, Any] = {
        "resolution": size,
        "renderer": renderer,
        "samples": values.samples,
        "edits": edits,
        "signals": signals,
    }
    settings |= {"cameras": cameras, "meshes": meshes, "compression": values.compression}
    report = generate(folder, recipe, splits=splits, seed=values.seed, **settings, run=run)
    _print_report(folder, report, splits)
    return EXIT_OK


def _announce_compilation() -> None:
    from datagen.console.progress import status_console
    from datagen.render.raster import is_compiled

    if not is_compiled():
        status_console().print("Compiling the renderer, once on this machine; this can take half a minute.")


def _meshes(values: Generate, recipe: Recipe) -> "Library | None":
    """The meshes of --assets; warnings about them go to standard error."""
    if values.assets is None:
        if values.unit or values.up or values.scale != 1.0 or values.assets_split:
            raise UsageError("--unit, --up, --scale and --assets-split are about the meshes of --assets; give it too.")
        return None

    from datagen.meshes.survey import Reading, make_library

    library, messages = make_library(
        values.assets,
        Reading(values.unit, values.up, values.scale, values.hull_seconds),
        categories=recipe.objects.categories,
        shares=options.parse_shares(values.assets_split),
        note=lambda name: print(f"Reading {name}", file=sys.stderr),
    )
    for message in messages:
        print(message, file=sys.stderr)
    return library


def _render(values: Render) -> int:
    # Settings of the source, and the cameras to render it with.
    spec = read_spec(values.source)
    recipe = rendered_recipe_of(spec)
    wanted = dataclasses.replace(recipe, rig=values.rig, views=values.views)
    size = options.parse_resolution(values.resolution) if values.resolution else None
    edits = options.parse_names("--edits", values.edits, EDITS)
    signals = options.parse_names("--with", values.signals, SIGNALS)
    cameras = _cameras(values.cameras)
    if cameras and wanted != recipe:
        raise UsageError("--cameras replaces the rig; leave out --rig.* and --views.")
    size = size or (cameras.resolution if cameras else None)
    folder = values.out or options.default_folder(
        recipe.name + "-rig" * (wanted != recipe or cameras is not None),
        size or spec["resolution"] or recipe.resolution,
        spec["seed"],
    )
    run = _how(values)

    from datagen.pipeline.generate import render

    if values.renderer != "pyrender":
        _announce_compilation()
    rig = wanted if wanted != recipe else None
    settings: dict[str, Any] = {"renderer": values.renderer, "samples": values.samples, "rig": rig, "edits": edits}
    settings |= {"assets": values.assets, "signals": signals, "cameras": cameras, "compression": values.compression}
    report = render(values.source, folder, resolution=size, **settings, run=run)
    _print_report(folder, report, spec["splits"])
    return EXIT_OK


def _cameras(path: Path | None) -> Any:
    if path is None:
        return None
    from datagen.storage.cameras_file import read_cameras

    return read_cameras(path)


def _how(values: Generate | Render) -> Any:
    workers, share = options.parse_workers(values.workers), options.parse_share(values.shard)

    from datagen.console.progress import scene_progress
    from datagen.pipeline.generate import Run

    if values.dask is not None and (values.shard or values.workers):
        raise UsageError("--dask makes all shards by the cluster's workers; leave out --shard and --workers.")
    return Run(workers=workers, dask=values.dask, share=share, overwrite=values.overwrite, progress=scene_progress)


def _print_report(folder: Path, report: "Report", wanted: dict[str, int]) -> None:
    splits = report.spec["splits"]
    if any(number > wanted.get(name, 0) for name, number in splits.items()):
        print("The dataset has more scenes than requested; none was deleted.")
    counts = ", ".join(f"{number} {name}" for name, number in splits.items())
    print(f"{folder.resolve()}: {counts} scenes; {report.scenes_made} made in {report.seconds:.1f} s.")
    if not report.complete:
        print("Shards are still missing; other --shard jobs, or the same command without --shard, make them.")
        return
    split = next(name for name, number in splits.items() if number)
    text = _LOADING + (_LOADING_PIXELS if report.spec["renderer"] else _LOADING_POSES)
    print(text.format(folder=folder, split=split), end="")


def _verify(values: Verify) -> int:
    from datagen import verify

    if values.sample is not None and values.sample < 1:
        raise UsageError(f"--sample {values.sample}: expected at least 1.")
    workers = options.parse_workers(values.workers)
    return verify.run(values.folder, workers=workers, assets=values.assets, sample=values.sample)


def _stats(values: Stats) -> int:
    from datagen.inspect import stats

    stats.run(values.folder)
    return EXIT_OK


def _preview(values: Preview) -> int:
    from datagen.inspect import preview

    for path in preview.run(
        values.folder, split=values.split, scenes=values.scenes, out=values.out, video=values.animation
    ):
        print(path)
    return EXIT_OK


def _inspect(values: Inspect) -> int:
    _check_scene(values)

    from datagen.inspect import stats

    stats.inspect(values.folder, values.split, values.scene)
    return EXIT_OK


def _regenerate(values: Regenerate) -> int:
    _check_scene(values)

    from datagen.pipeline.generate import regenerate

    differing = regenerate(values.folder, values.split, values.scene, values.assets)
    place = f"{values.folder}, {values.split} scene {values.scene}"
    if differing:
        print(f"{place}: these arrays differ from what is stored: {', '.join(differing)}")
        return EXIT_VERIFICATION
    print(f"{place}: generated again; every array has the stored SHA-256.")
    return EXIT_OK


def _export(values: Export) -> int:
    from datagen.console.progress import scene_progress
    from datagen.formats.export import export

    splits = options.parse_names("--splits", values.splits, SPLITS)
    settings: dict[str, Any] = {"assets": values.assets, "overwrite": values.overwrite, "progress": scene_progress}
    counts = export(values.folder, values.out, values.format, splits=splits, **settings)
    print(f"{values.out.resolve()}: {', '.join(f'{number} {split}' for split, number in counts.items())} scenes.")
    print(f"How to load them, and what the format leaves out: {values.out / CARD_FILE}")
    return EXIT_OK


def _push(values: Push) -> int:
    from datagen.formats.push import plan_upload, push

    upload = plan_upload(values.folder, values.repository)
    size = f"{len(upload.files)} files, {upload.size / 1e6:.1f} MB"
    if values.dry_run:
        for name in upload.files:
            print(f"  {name}")
        print(f"{size}, would go to {upload.address} ({'public' if values.public else 'private'} if new).")
        return EXIT_OK
    push(values.folder, upload, private=not values.public)
    print(f"{upload.address}: {size}.")
    return EXIT_OK


def _assets(values: Assets) -> int:
    from datagen.inspect import assets_check
    from datagen.meshes.survey import Reading

    reading = Reading(values.unit, values.up, values.scale, values.hull_seconds)
    return assets_check.run(values.folder, reading, values.out)


def _check_scene(values: Inspect | Regenerate) -> None:
    scenes = Dataset(values.folder).splits[values.split]
    if not 0 <= values.scene < scenes:
        raise UsageError(f"--scene {values.scene}: split {values.split} has scenes 0 to {scenes - 1}.")


COMMANDS = {
    "generate": Command(Generate, _generate, _default_generate),
    "render": Command(Render, _render, _default_render),
    "import": Command(importing.Import, importing.run),
    "verify": Command(Verify, _verify),
    "stats": Command(Stats, _stats),
    "preview": Command(Preview, _preview),
    "inspect": Command(Inspect, _inspect),
    "export": Command(Export, _export),
    "push": Command(Push, _push),
    "regenerate": Command(Regenerate, _regenerate),
    "assets": Command(Assets, _assets),
}

if __name__ == "__main__":
    sys.exit(main())
