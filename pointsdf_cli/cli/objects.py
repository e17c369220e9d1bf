"""`rgrasp objects`: meshes to work on, made or fetched."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from pointsdf_cli.cli import common
from pointsdf_cli.errors import InputError

app = typer.Typer(
    help="Household objects: made by rule, or fetched from the YCB set.",
    no_args_is_help=True,
    rich_markup_mode=None,
)

SheetFile = Annotated[
    Path | None, typer.Option(help="Also draw the first 60 objects into this PNG.")
]
Out = Annotated[Path, typer.Option(help="Output folder: one PLY per object.")]


@app.command("make")
def make(
    out: Out = Path("meshes"),
    count: Annotated[int, typer.Option("--count", "-n", help="Number of objects.")] = 100,
    families: Annotated[
        str | None,
        typer.Option(metavar="a,b,…", help="Families to make, such as mug,bowl; all if not given."),
    ] = None,
    sheet: SheetFile = None,
    seed: common.Seed = 0,
    jobs: common.Jobs = 0,
    shard: common.Shard = None,
    force: common.Force = False,
    quiet: common.Quiet = False,
    as_json: common.Json = False,
) -> None:
    """Make household objects, no two alike: watertight meshes in metres, standing on z = 0.

    Example: rgrasp objects make --out meshes/ --count 500 --seed 0 --sheet meshes.png
    """
    from collections import Counter

    from pointsdf_cli.io.batch import shard_of
    from pointsdf_cli.objects.store import MANIFEST, check_count, make_objects

    chosen = None if families is None else [name.strip() for name in families.split(",")]
    common.check_picture(sheet, force)
    reporter = common.Reporter(quiet, as_json)
    total = len(shard_of(range(check_count(count)), shard))
    with reporter.progress("objects", total) as progress:
        report = make_objects(out, count, seed, chosen, jobs, shard, force, progress.advance)
    mix = Counter(about["family"] for about in report.made.values())
    rate = len(report.made) / report.seconds if report.seconds else 0.0
    if sheet:
        _draw_sheet(sheet, [out / f"{name}.ply" for name in sorted([*report.made, *report.kept])])
    counts = dict(sorted(mix.items()))
    values = {"objects_per_second": rate, "families": counts, "sheet": sheet}
    lines = [f"{len(mix)} families, {rate:.0f} objects a second; listed in {out / MANIFEST}"]
    lines += [f"{sheet}: contact sheet"] if sheet else []
    reporter.finish(report, out, False, values, lines)


@app.command("fetch")
def fetch(
    collection: Annotated[
        Literal["ycb"], typer.Argument(help="ycb: the YCB object set, 600 MB in all.")
    ],
    out: Out = Path("ycb"),
    objects: Annotated[
        str | None,
        typer.Option(
            metavar="003,006,…", help="Objects to fetch, by number or name; all if not given."
        ),
    ] = None,
    base_url: Annotated[
        str | None, typer.Option(help="Address of the archives NAME_google_16k.tgz.")
    ] = None,
    sheet: SheetFile = None,
    force: common.Force = False,
    skip_bad: common.SkipBad = False,
    quiet: common.Quiet = False,
    as_json: common.Json = False,
) -> None:
    """Fetch scanned objects as watertight meshes; resumes, and verifies known checksums.

    Example: rgrasp objects fetch ycb --out ycb/ --objects 003,006,025
    """
    from pointsdf_cli.objects.fetch import YCB_BASE_URL, fetch_ycb
    from pointsdf_cli.objects.ycb_names import choose_ycb

    wanted = None if objects is None else [name.strip() for name in objects.split(",")]
    common.check_picture(sheet, force)
    reporter = common.Reporter(quiet, as_json)
    address = base_url or YCB_BASE_URL
    with reporter.progress("fetch", len(choose_ycb(wanted))) as progress:
        states, refused = fetch_ycb(out, wanted, address, force, on_done=progress.advance)
    if sheet and states:
        _draw_sheet(sheet, [out / f"{name}.ply" for name in states])
    fetched = [name for name, state in states.items() if state == "fetched"]
    kept = len(states) - len(fetched)
    if states:
        values = {"out": out, "fetched": fetched, "kept": kept, "sheet": sheet}
        reporter.result(values, [f"{out}: {len(fetched)} fetched, {kept} there already"])
    if refused and skip_bad and states:
        reporter.say(*(f"skipped: {error.message}" for error in refused))
    elif len(refused) == 1:
        raise refused[0]
    elif refused:
        reasons = "\n".join(f"  {error.message}" for error in refused[:10])
        raise InputError(f"{len(refused)} objects cannot be used:\n{reasons}", where=out)


def _draw_sheet(path: Path, meshes: list[Path]) -> None:
    from pointsdf_cli.viz.contact_sheet import items_from_files, write_sheet

    write_sheet(path, items_from_files(meshes[:60]))
