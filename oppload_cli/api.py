"""The API for Python: functions that run detectors and read results, and the class of a result."""

from __future__ import annotations

import json
import os.path
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field
from io import StringIO
from numbers import Real
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, cast

import pandas as pd

from oppload_cli.errors import OutputError, ParameterError, StimulusError, counted
from oppload_cli.files.atomic import part_of, write_atomic
from oppload_cli.files.reading import is_file, path_of
from oppload_cli.files.tables import Seconds, Table
from oppload_cli.pipeline.execute import analyse_source
from oppload_cli.pipeline.settings import check_assignments, resolve
from oppload_cli.pipeline.sources import StimulusVideo, open_source
from oppload_cli.pipeline.task import IfExists, Outputs
from oppload_cli.report.writing import write_report
from oppload_cli.results import result_files
from oppload_cli.results.table import TABLE, detection_line, detection_values, write_sidecar
from oppload_cli.results.truths import facts_of_truth, usable_truth
from oppload_cli.results.tuning import tuning_of
from oppload_cli.stimulus.files import file_stem
from oppload_cli.stimulus.truth import ground_truth
from oppload_cli.tuning import measuring
from oppload_cli.tuning.sweeps import EXAMPLES, sweeps
from oppload_cli.video.inputs import GROUND_TRUTH, result_stem
from oppload_cli.video.source import Video

if TYPE_CHECKING:
    from collections.abc import Sequence
    from fractions import Fraction

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from oppload_cli.pipeline.sources import Source, Times
    from oppload_cli.results.record import FrameRecord
    from oppload_cli.results.tuning import Tuning


_DETECTION_COLUMNS = (
    "frame", "time_s", "id", "x", "y", "width", "height", "centre_x", "centre_y", "response",
    "alarm", "time_to_contact_s", "time_to_contact_error_s",
)  # fmt: skip
# What messages on a sweep say of the options of the command, and what they say in Python.
_ARGUMENTS = {
    EXAMPLES: "[10, 20, 40], range(0, 360, 30) or [[0, 0], [10, 0]]",
    "--over direction=0:315:45": "over={'direction': range(0, 360, 45)}",
    "0:315:45": "range(0, 360, 45)",
    "choose all, ": "choose ",
    "--over": "over",
    "--change": "changes",
    "--figure": "figure",
}
# The types of the columns that are not floats. Pandas takes them from the rows, if there are any.
_NOT_FLOATS: dict[str, type] = {"frame": int, "id": int, "alarm": bool}


@dataclass(frozen=True, eq=False, repr=False)
class Result(result_files.BaseResult):
    """The result of one input, from :func:`run` or :func:`read_result`.

    Attributes
    ----------
    path : Path
        The path of the table; only a file name if the result was not read from files.
    frames : DataFrame
        A row per frame, with the columns of ``frames.csv``; empty cells are NaN.
    sidecar : dict
        The content of ``oppload.json``: settings, facts about the input, versions.
    detections : DataFrame
        A row per looming object and frame, as in ``detections.jsonl``.
    saved : bool
        Whether the result was read from files.

    Examples
    --------
    >>> import oppload_cli as oppload
    >>> result = oppload.run("controls/looming-perspective", rmo=False)
    >>> result
    Result('controls/looming-perspective', 102 frames, opplod: 1 alarm, dlgmd: 1 alarm)
    >>> result.frames.columns[:5].tolist()
    ['frame', 'time_s', 'luma_change', 'opplod_response', 'opplod_threshold']
    >>> bool(result.summary["dlgmd"]["alarm_frames"] == result.frames["dlgmd_alarm"].sum())
    True
    """

    detections: pd.DataFrame = field(default_factory=lambda: _detections([]))
    saved: bool = False

    def __repr__(self) -> str:
        name = self.part("input").get("name") or self.stem
        parts = [repr(str(name)), counted(len(self.frames), "frame")]
        alarm = self.part("parameters").get("alarm")
        if isinstance(alarm, dict) and alarm.get("on") is False:
            parts += [*self.models, "alarms are off"]
        else:
            for model in self.models:
                alarms = result_files.alarm_rows(self, model)
                parts.append(f"{model}: {counted(len(alarms), 'alarm')}")
        if self.part("decode").get("complete") is False:
            parts.append("incomplete: see sidecar['decode']")
        if remarks := self.sidecar.get("remarks"):
            parts.append(f"{counted(len(remarks), 'remark')}: see sidecar['remarks']")
        return f"Result({', '.join(parts)})"

    @property
    def summary(self) -> dict[str, dict[str, Any]]:
        """Peak, first response and first alarm of each detector, by its name.

        Examples
        --------
        >>> import oppload_cli as oppload
        >>> sorted(oppload.run("controls/size-steps", rmo=False).summary["dlgmd"])[:3]
        ['alarm_frames', 'first_alarm_frame', 'first_alarm_time_s']
        """
        return dict(self.sidecar.get("summary", {}))

    def plot(self, **options: Any) -> tuple[Figure, list[Axes]]:
        """Draw the responses over time.

        Parameters
        ----------
        **options
            `models`, `scale` (``threshold``, ``peak``, ``raw``), `align`, `xlim`, `title`,
            `labels`, `marks`, `threshold`, `any_length` and `axes`, as for
            :func:`oppload_cli.plot_curves`.

        Examples
        --------
        >>> import oppload_cli as oppload
        >>> result = oppload.run("controls/looming-perspective", rmo=False)
        >>> figure, axes = result.plot(scale="peak", models=["opplod"])
        >>> axes[0].get_ylabel()
        'response / peak'
        """
        from oppload_cli.plots.curves import plot_curves  # noqa: PLC0415 - loads matplotlib

        return plot_curves(self, **options)

    def report(self, folder: str | Path = ".", *, video: str | Path | None = None) -> Path:
        """Write the page of ``oppload report``: video, boxes, curves and alarms in sync.

        A result that was read from files gives the page of these files. If you changed its tables,
        save it first, and read it again.

        Parameters
        ----------
        folder : str or Path
            Folder of the page, made if it does not exist. A page of the same name is replaced.
        video : str or Path, optional
            The video, or its folder, if the video was moved. Without a video, the page shows only
            the curves.

        Returns
        -------
        Path
            The page, for any browser.

        Raises
        ------
        OpploadError
            If the page cannot be made.

        Examples
        --------
        >>> import tempfile, oppload_cli as oppload
        >>> result = oppload.run("controls/looming-perspective", rmo=False)
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     print(result.report(folder).name)
        controls_looming-perspective.report.html
        """
        videos = None if video is None else path_of(video, "video")
        with TemporaryDirectory() as kept:
            path = self.path if self.saved else self.save(kept)
            return write_report([path], path_of(folder, "folder"), videos=videos).first

    def save(
        self, folder: str | Path = ".", stem: str | None = None, *, if_exists: str = "error"
    ) -> Path:
        """Write the files that ``oppload run`` writes, and the ground truth of a stimulus.

        Parameters
        ----------
        folder : str or Path
            Folder of the files, made if it does not exist.
        stem : str, optional
            The beginning of the names of the files; by default it follows from the input's name.
        if_exists : str
            ``error``, ``overwrite``, or ``skip``, which keeps a complete result.

        Returns
        -------
        Path
            The table, ``{stem}.frames.csv``.

        Raises
        ------
        OutputError
            If a file exists already, or cannot be written.
        ParameterError
            If `if_exists` is another word.

        Examples
        --------
        >>> import tempfile, oppload_cli as oppload
        >>> result = oppload.run("controls/looming-perspective", rmo=False)
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = result.save(folder)
        ...     again = oppload.read_result(path)
        >>> path.name, len(again.frames), len(again.detections) == len(result.detections)
        ('controls_looming-perspective.frames.csv', 102, True)
        """
        try:
            existing = IfExists(if_exists)
        except ValueError:
            words = ", ".join(IfExists)
            raise ParameterError(f"if_exists must be one of {words}, not {if_exists!r}") from None
        folder, stem = path_of(folder, "folder"), file_stem(stem or self.stem)
        outputs = Outputs.of(folder, stem, self.models)
        truth_path = folder / f"{stem}{GROUND_TRUTH}"
        sidecar = dict(self.sidecar)
        truth = _own_truth(self)
        paths = [*([truth_path] if truth else []), *outputs.paths()]
        paths += map(part_of, outputs.paths())
        existing_path = next(filter(os.path.lexists, paths), None)
        if existing_path is not None and existing is IfExists.ERROR:
            raise OutputError(
                f"{existing_path}: exists already; choose if_exists='overwrite' or 'skip', or "
                "another folder or stem"
            )
        table = None if outputs.kept(existing) else outputs.begin(existing)
        if table is None:
            return outputs.csv
        with table as file:
            rows = Table(file.stream, self.frames.columns)
            for row in _rows_of(self.frames):
                rows.write(row | {"time_s": Seconds(row["time_s"])})
            file.stream.flush()
            outputs.remove_earlier()  # the new table gets its name last, as in a run
            if truth:
                write_atomic(truth_path, json.dumps(truth) + "\n")
                sidecar["stimulus"] = facts_of_truth(truth_path, truth)
            if outputs.detections is not None:
                lines = [detection_line(row) for row in _rows_of(self.detections)]
                write_atomic(outputs.detections, "".join(lines))
            sidecar.pop("schema", None)
            write_sidecar(outputs.sidecar, sidecar)
        return outputs.csv


def run(
    source: Source,
    models: Sequence[str] = (),
    *,
    rate: float | Fraction | None = None,
    times: Times | None = None,
    height: int | str | None = None,
    fov: float | None = None,
    rmo: bool = True,
    settings: Mapping[str, Any] | None = None,
) -> Result:
    """Run detectors on a video, a stimulus or an array, and keep the result in memory.

    Parameters
    ----------
    source : str, Path, FrameSource, Protocol or array
        As for :func:`oppload_cli.open_source`.
    models : sequence of str
        Names of detectors; OppLoD and D-LGMD if left out.
    rate, times, height
        As for :func:`oppload_cli.open_source`.
    fov : float, optional
        Field of view across the width of the frame in degrees; a stimulus states its own.
    rmo : bool
        Whether to measure radial motion opponency.
    settings : mapping of str, optional
        Values of single parameters, such as ``{"opplod.gain": 2}``.

    Returns
    -------
    Result
        The result, with the same values as the files of ``oppload run`` for this input.

    Raises
    ------
    SourceError
        If nothing can be read from the source.
    StimulusError
        If the stimulus of a TOML file is not valid, or if the file has several.
    ParameterError
        If a name or a value is wrong, or a setting belongs to a part that does not run.

    Examples
    --------
    >>> import numpy as np, oppload_cli as oppload
    >>> flat = np.full((20, 60, 80), 128, np.uint8)
    >>> result = oppload.run(flat, ["dlgmd"], rate=30)
    >>> float(result.frames["dlgmd_response"].max())
    0.0
    """
    if not isinstance(rmo, bool):
        raise ParameterError(
            f"rmo must be True or False, not {rmo!r:.60}; its parameters go into settings, "
            "e.g. {'rmo.grid': 20}"
        )
    wanted = _wanted(models, height, settings)
    chosen = resolve(**wanted, fov=None if fov is None else str(fov), measure_rmo=rmo)
    check_assignments(wanted["assignments"], chosen.models, measure_rmo=rmo)
    records: list[FrameRecord] = []
    heights: Any = {"height": chosen.height, "others": chosen.other_heights}
    with open_source(source, rate=rate, times=times, **heights) as frames:
        truth = ground_truth(frames.protocol) if isinstance(frames, StimulusVideo) else None
        columns, sidecar = analyse_source(frames, chosen, records.append, truth)
        # Only the name of a video is a path; those of stimuli and arrays are not.
        is_video = isinstance(frames, Video)
    detections = [detection_values(record, one) for record in records for one in record.detections]
    name = sidecar["input"]["name"]
    stem = result_stem(name) if is_video else file_stem(name)
    table = _table([record.values() for record in records], columns)
    return Result(Path(f"{stem}{TABLE}"), table, sidecar, _detections(detections))


def tune(
    stimulus: str | Path | None = None,
    over: Mapping[str, Iterable[Any] | None] | None = None,
    *,
    figure: str | None = None,
    changes: Mapping[str, Any] | None = None,
    models: Sequence[str] = (),
    height: int | str | None = None,
    settings: Mapping[str, Any] | None = None,
    indicator_s: float = 0.0,
) -> Tuning:
    """Measure the tuning of detectors to one stimulus, as ``oppload tune``, in one process.

    Parameters
    ----------
    stimulus : str or Path, optional
        A name of the catalogue, or a TOML file; left out with `figure`.
    over : mapping, optional
        The values of each swept parameter, such as ``{"axis": range(0, 180, 15)}``; None in place
        of the values for those of the stimulus's own sweep. If left out, the stimulus keeps its own
        sweep. A parameter is a word such as ``axis`` or ``l/v``, or a key such as ``bar.axis_deg``.
    figure : str, optional
        The name of a classic figure, such as ``peak-time``, in place of a stimulus.
    changes : mapping, optional
        Changed values of the stimulus, such as ``{"display.frame_rate": 60}``.
    models, height, settings
        As for :func:`run`.
    indicator_s : float
        Time constant in s, 0 to 60, of a calcium indicator that shows the responses; 0 for none.

    Returns
    -------
    Tuning
        The table, with the same values as the files of ``oppload tune``; :func:`plot_tuning` draws
        it.

    Raises
    ------
    StimulusError
        If there is no such stimulus, if it is not valid with one of the values, or if nothing is
        swept.
    ParameterError
        If a name or a value is wrong.
    ResultError
        If a detector has no peak, because every stimulus ends during its warm-up.

    Examples
    --------
    >>> import oppload_cli as oppload
    >>> over = {"l/v": [40, 80]}
    >>> tuning = oppload.tune("klapoetke2017/loom-l-over-v", over, models=["opplod_reference"])
    >>> tuning.rows[["disk.growth.l_over_v_ms", "peak_before_contact_s"]].round(2).values.tolist()
    [[40.0, 0.13], [80.0, 0.23]]
    """
    from oppload_cli.plots.tuning_plots import summary_of  # noqa: PLC0415 - loads matplotlib

    if (stimulus is None) == (figure is None):
        raise ParameterError("give a stimulus or a figure, one of the two")
    if str(figure) == "all":
        raise ParameterError("figure must be one figure, such as 'peak-time', not 'all'")
    for name, value in (("over", over), ("changes", changes)):
        if not isinstance(value, Mapping | None):
            raise ParameterError(f"{name} must be a dict by parameter, not {value!r:.60}")
        for key in value or ():
            if not isinstance(key, str):
                raise ParameterError(f"{name}: a parameter is a word or a key, not {key!r:.60}")
    indicator: object = indicator_s  # maybe of a wrong type
    if not isinstance(indicator, Real) or not 0 <= indicator_s <= 60:
        raise ParameterError(f"indicator_s must be 0 to 60 seconds, not {indicator!r:.60}")
    indicator_s = float(indicator_s)  # the sidecar takes no numbers of NumPy
    swept = {
        name: None if values is None else _listed(name, values)
        for name, values in (over or {}).items()
    }
    wanted = _wanted(models, height, settings)
    named = None if stimulus is None else str(stimulus)
    figures = [] if figure is None else [str(figure)]
    try:
        (sweep,) = sweeps(named, figures, dict(changes or {}), swept, wanted)
    except (ParameterError, StimulusError) as error:
        raise type(error)(_in_python(str(error))) from error
    conditions = measuring.tune(sweep, indicator_s=indicator_s)
    doubts = list(measuring.doubts_about(conditions, sweep, indicator_s))
    sidecar = measuring.tuning_sidecar(sweep, command=(), indicator_s=indicator_s, doubts=doubts)
    # The numbers are rounded as in a file, and empty cells are NaN.
    text = StringIO(measuring.tuning_text(conditions))
    rows = pd.read_csv(text, keep_default_na=False, na_values=[""])
    path = Path(f"{file_stem(sweep.entry.name)}.tuning.csv")
    measured = tuning_of(path, rows, sidecar)
    sidecar["summary"] = summary_of(measured)
    return measured


def _in_python(message: str) -> str:
    """Return a message on a sweep with the arguments of `tune` in place of the options."""
    for of_command, of_python in _ARGUMENTS.items():
        message = message.replace(of_command, of_python)
    return message


def _listed(name: str, values: Iterable[Any]) -> list[Any]:
    """Return the values of a swept parameter as a list; raise ParameterError for no values."""
    single = getattr(values, "ndim", 1) == 0  # an array of one number
    if isinstance(values, str) or single or not isinstance(values, Iterable):
        raise ParameterError(f"over: the values of '{name}' must be a list, not {values!r:.60}")
    return [list(value) if isinstance(value, tuple) else value for value in map(_plain, values)]


def _wanted(
    models: Sequence[str],
    height: int | str | None,
    settings: Mapping[str, Any] | None,
) -> dict[str, Any]:
    """Return the arguments of `resolve` that follow from those of `run` and `tune`."""
    names: object = [models] if isinstance(models, str) else models  # maybe of a wrong type
    if not isinstance(names, Collection) or not all(isinstance(name, str) for name in names):
        raise ParameterError(f"models must be a list of names of detectors, not {models!r}")
    if not isinstance(settings, Mapping | None):
        raise ParameterError(
            f"settings must be a dict, e.g. {{'rmo.grid': 20}}, not {settings!r:.60}"
        )
    for setting, value in (settings or {}).items():
        if "." not in str(setting) or isinstance(value, Mapping):
            raise ParameterError(
                f"settings must name parameters with their set, e.g. {{'rmo.grid': 20}}, not "
                f"{ {setting: value}!r:.60}"
            )
    return {
        "models": list(names),
        "height": None if height is None else str(height),
        "assignments": {str(name): _plain(value) for name, value in (settings or {}).items()},
    }


def _plain(value: object) -> object:
    """Return the value of a setting without NumPy: a list for an array, a number for one number."""
    return getattr(value, "tolist", lambda: value)()


def read_result(path: str | Path) -> Result:
    """Read a result that :func:`run` or ``oppload run`` has saved.

    Parameters
    ----------
    path : str or Path
        A ``frames.csv``. If the sidecar and the detections are in its folder, they are read too.

    Raises
    ------
    ResultError
        If a file cannot be read, or is not a result.

    Examples
    --------
    >>> import oppload_cli as oppload
    >>> oppload.read_result("missing.frames.csv")  # doctest: +ELLIPSIS
    Traceback (most recent call last):
    ...
    oppload_cli.errors.ResultError: missing.frames.csv: cannot be read (no such file...
    """
    read = result_files.read_result(path_of(path, "path"))
    detections = _detections(result_files.read_detections(read.path) or [])
    return Result(read.path, read.frames, read.sidecar, detections, saved=True)


def _own_truth(result: Result) -> dict[str, Any] | None:
    """Return the ground truth that is a part of the result, or a file beside it."""
    stated = result.part("stimulus")
    beside = result.path.with_name(f"{result.stem}{GROUND_TRUTH}")
    own = "frames" in stated or (stated and result.saved and is_file(beside))
    return usable_truth(result) if own else None


def _table(rows: Sequence[Mapping[str, Any]], columns: Sequence[str]) -> pd.DataFrame:
    """Return rows as a table of numbers; None becomes NaN, and True becomes 1.

    Whole numbers without None, such as alarms, keep their type, as in a table that is read.
    """
    table = pd.DataFrame.from_records(list(rows), columns=list(columns))
    kinds = {name: int if table[name].dtype.kind in "bi" else float for name in columns}
    return table.astype({name: kind for name, kind in kinds.items() if name != "frame"})


def _detections(rows: Sequence[Mapping[str, Any]]) -> pd.DataFrame:
    """Return detections as a table whose types are the same without a row; None is NaN."""
    # If the field of view is known, rows also have columns in degrees.
    columns = dict.fromkeys([*_DETECTION_COLUMNS, *(rows[0] if rows else ())])
    table = pd.DataFrame.from_records(list(rows), columns=list(columns))
    kinds: dict[str, type] = {name: float for name in columns if name not in _NOT_FLOATS}
    return table.astype(kinds if rows else kinds | _NOT_FLOATS)


def _rows_of(table: pd.DataFrame) -> list[dict[str, Any]]:
    return cast(
        "list[dict[str, Any]]", table.astype(object).where(table.notna(), None).to_dict("records")
    )
