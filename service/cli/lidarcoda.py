"""Verbs `lidarcoda build`, `grade` and `evaluate`: point labels from CODA's boxes, and measures."""

import sys
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from service.cli.options import Json
from service.cli.output import counted, json_line, progress, remark, table
from service.errors import UsageError
from service.output_files import need_folder

if TYPE_CHECKING:
    from workers.lab.lidarcoda.evaluation import Evaluation, Row

Source = Annotated[
    Path,
    typer.Argument(help="Folder with corner_case.json, lidar/NNNN.bin, calib/NNNN and image/."),
]
Built = Annotated[Path, typer.Option("--out", help="Folder of the build.")]
Published = Annotated[
    bool, typer.Option("--published", help="Use the published form, with its errors.")
]
GradesFile = Annotated[
    Path | None,
    typer.Option("--grades", help="File of grades: line i is the grade, 1 to 9, of annotation i."),
]


def add_to(app: typer.Typer) -> None:
    """Add the verbs of this file to the command."""
    group = typer.Typer(
        no_args_is_help=True, help="Make point labels from CODA's 2D boxes, and evaluate on them."
    )
    group.command(epilog="counterpoint lidarcoda build coda --out lidarcoda")(build)
    group.command(epilog="counterpoint lidarcoda grade coda --out lidarcoda --set 12=3")(grade)
    group.command(epilog="counterpoint lidarcoda evaluate coda --out lidarcoda --method output")(
        evaluate
    )
    app.add_typer(group, name="lidarcoda")


def build(
    source: Source,
    out: Built,
    grades: GradesFile = None,
    published: Published = False,
    parquet: Annotated[
        bool, typer.Option("--parquet", help="Also write labels.parquet, with point indices.")
    ] = False,
    json: Json = False,
) -> None:
    """Cluster the lidar points in each box, and write point labels of every graded image.

    A build that was interrupted goes on where it stopped.
    """
    from workers.lab.lidarcoda.annotations import read_coda
    from workers.lab.lidarcoda.build import build as run
    from workers.lab.lidarcoda.table_file import need_pyarrow, write_table

    if parquet:
        need_pyarrow()
    coda = read_coda(source)
    need_folder(out, option="--out")
    _import_grades(out, grades, published=published)
    with progress() as bar:
        task = bar.add_task("clustering", total=len(coda.annotations))
        built = run(
            *(source, out, coda),
            published=published,
            on_progress=lambda done: bar.update(task, completed=done),
        )
    rows = write_table(out, coda) if parquet else None
    if json:
        json_line(asdict(built))
        return
    remark(
        f"{out}: {counted(built.annotations, 'annotation')} of {counted(built.images, 'image')}, "
        f"{built.clustered} clustered now; {built.points} points in boxes, "
        f"{counted(built.empty, 'annotation')} without points"
    )
    if rows is not None:
        remark(f"{out / 'labels.parquet'}: {counted(rows, 'row')}")
    remark(f"point labels of {counted(built.labelled_images, 'image')}")
    if built.ungraded:
        remark(
            f"{counted(built.ungraded, 'annotation')} without a grade; next: "
            f"counterpoint lidarcoda grade {source} --out {out}"
        )


def grade(
    source: Source,
    out: Built,
    chosen: Annotated[
        list[str] | None, typer.Option("--set", help="ANNOTATION=GRADE. Repeatable.")
    ] = None,
    grades: GradesFile = None,
    pictures: Annotated[
        Path | None, typer.Option("--pictures", help="Draw every ungraded annotation there.")
    ] = None,
) -> None:
    """Grade the two clusterings of each annotation, from 1 to 9, by its picture.

    Right are 1: DBSCAN, 2: mean shift, 3: both, 4: their union. Chosen is the rest by 5: DBSCAN, 8:
    mean shift. Wrong are 6: the clusters, 7: the annotation, 9: the clusters, which are too fine.
    On a terminal the command asks for each ungraded annotation.
    """
    from workers.lab.lidarcoda.annotations import read_coda
    from workers.lab.lidarcoda.grades import read_grades, write_grades

    coda = read_coda(source)
    known = {each.id for each in coda.annotations}
    need_folder(out, option="--out")
    _import_grades(out, grades, published=False)
    found = read_grades(out)
    for text in chosen or ():
        annotation, value = _one_grade(text, known)
        found[annotation] = value
    write_grades(out, found)
    ungraded = [each for each in coda.annotations if each.id not in found]
    if pictures is not None:
        _draw(source, out, pictures, [each.id for each in ungraded])
    if not chosen and grades is None and sys.stdin.isatty():
        for each in ungraded:
            where = f" ({pictures / f'{each.id}.png'})" if pictures else ""
            answer = typer.prompt(f"annotation {each.id}, {each.category}{where}: grade, or q")
            if answer.strip() == "q":
                break
            found[each.id] = _one_grade(f"{each.id}={answer}", known)[1]
            write_grades(out, found)
    remaining = sum(each.id not in found for each in coda.annotations)
    remark(f"{counted(len(coda.annotations) - remaining, 'annotation')} graded, {remaining} not")
    remark(f"next: counterpoint lidarcoda build {source} --out {out}")


def evaluate(
    source: Source,
    out: Built,
    method: Annotated[
        Path,
        typer.Option(
            "--method",
            help="Folder with NNNN.bin for each image (float32 x, y, z, category), or the "
            "published folder anomalies_sup_self.",
        ),
    ],
    pictures: Annotated[
        Path | None, typer.Option("--pictures", help="Folder for pies of the confusion.")
    ] = None,
    json: Json = False,
) -> None:
    """Compute both tables of the paper, in published and corrected form, next to its numbers."""
    from workers.lab.lidarcoda.annotations import read_coda
    from workers.lab.lidarcoda.evaluation import evaluate as run
    from workers.lab.lidarcoda.pictures import draw_pies
    from workers.lab.plots import need_matplotlib
    from workers.lidar.fidelity import Form

    if pictures is not None:
        need_matplotlib()
        need_folder(pictures, option="--pictures")
    coda = read_coda(source)
    published = run(out, method, coda, form=Form.PAPER)
    corrected = run(out, method, coda, form=Form.CORRECTED)
    if json:
        for name, found in (("published", published), ("corrected", corrected)):
            for kind, rows in (("frames", found.frames), ("annotations", found.annotations)):
                for row in rows:
                    json_line({"form": name, "table": kind, **asdict(row)})
    else:
        _tables(published, corrected)
    if corrected.without_output:
        remark(f"{counted(corrected.without_output, 'labelled image')} without the method's output")
    if corrected.unlabelled:
        remark(f"{counted(corrected.unlabelled, 'image')} without point labels: not all graded")
    if pictures is not None:
        for path in draw_pies(pictures, corrected, form=Form.CORRECTED):
            remark(f"{path}")


def _tables(published: "Evaluation", corrected: "Evaluation") -> None:
    columns = ("mIoU", "AP", "AR", "F1")
    for title, first, second in (
        ("frames: all points, the object's points are the anomaly", "frames", "data set"),
        ("annotations: points with both labels", "annotations", "supercategory"),
    ):
        pairs = zip(getattr(published, first), getattr(corrected, first), strict=True)
        table(
            f"{title}; percent: corrected form, published form, the paper",
            (
                second,
                "n",
                *(f"{name} {form}" for form in ("", "publ.", "paper") for name in columns),
            ),
            (
                (
                    right.name,
                    right.measures.n,
                    *_percent(right),
                    *_percent(wrong),
                    *(f"{value:.1f}" for value in right.paper or ()),
                    *(["-"] * (0 if right.paper else 4)),
                )
                for wrong, right in pairs
            ),
        )
    table(
        "points of the method by category",
        ("data set", "1 both static", "2 both dynamic", "3 only predictive", "4 only semantic"),
        ((row.name, *row.outcomes) for row in corrected.frames),
    )


def _percent(row: "Row") -> tuple[str, str, str, str]:
    found = row.measures
    values = (found.mean_iou, found.average_precision, found.average_recall, found.f1)
    first, second, third, fourth = (f"{100 * value:.1f}" for value in values)
    return first, second, third, fourth


def _import_grades(out: Path, path: Path | None, *, published: bool) -> None:
    from workers.lab.lidarcoda.grades import read_grades, read_published_grades, write_grades

    if path is not None:
        write_grades(out, {**read_grades(out), **read_published_grades(path, published=published)})


def _one_grade(text: str, known: set[int]) -> tuple[int, int]:
    from workers.lab.lidarcoda.grades import checked_grade

    annotation, _, value = text.partition("=")
    if not annotation.isdecimal() or int(annotation) not in known:
        raise UsageError(
            f"--set: there is no annotation {annotation[:20]!r}; give ANNOTATION=GRADE"
        )
    return int(annotation), checked_grade(value.strip(), place=f"annotation {annotation}")


def _draw(source: Path, out: Path, folder: Path, ids: list[int]) -> None:
    from workers.lab.lidarcoda.annotations import read_coda
    from workers.lab.lidarcoda.cameras import read_camera
    from workers.lab.lidarcoda.files import read_box
    from workers.lab.lidarcoda.pictures import draw_annotation
    from workers.lab.plots import need_matplotlib

    need_matplotlib()
    need_folder(folder, option="--pictures")
    coda = read_coda(source)
    of = {each.id: each for each in coda.annotations}
    for number in ids:
        annotation = of[number]
        image = coda.images[annotation.image_id]
        draw_annotation(
            folder / f"{number}.png",
            image_file=source / "image" / image.file_name,
            image=image,
            annotation=annotation,
            box=read_box(out, number),
            camera=read_camera(source, image),
        )
    remark(f"{folder}: {counted(len(ids), 'picture')}")
