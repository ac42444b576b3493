"""`optdock calibrate`."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer

from optdock.cli.common import VerboseOption, check_picture, reported, spare, working

__all__ = ["calibrate"]


def calibrate(
    logs: Annotated[
        list[Path],
        typer.Argument(
            metavar="LOG...",
            help="Logs of dockings (JSON lines), run files, or recordings (.mcap, .db3) of one robot at one dock.",
            show_default=False,
        ),
    ],
    *,
    write: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", help="Write the results as keys of scenarios and settings (YAML).", show_default=False
        ),
    ] = None,
    report: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Write the table to a file as well.", show_default=False)
    ] = None,
    plot: Annotated[
        Path | None,
        typer.Option(
            metavar="PICTURE", help="Draw residuals and fits; the suffix gives the format.", show_default=False
        ),
    ] = None,
    coverage: Annotated[
        int,
        typer.Option(
            metavar="PERCENT", min=1, max=99, help="Percentage of dockings to stay inside the tube, robot.tracking."
        ),
    ] = 99,
    verbose: VerboseOption = False,
) -> None:
    """Estimate parameters of a robot, its sensors and its dock from recorded drives, with 95 % confidence intervals.

    The parameters are latency and lag of the drive, wheels, odometry, detections, localization, the stored dock and the
    tracking tube. Parameters that the recordings do not determine are listed with the reason. Use at least ten
    dockings.
    """
    # Must precede the import of NumPy: on a busy machine, linear algebra threads block each other.
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    with reported(verbose=verbose):
        from optdock.calibration import as_text, as_yaml, read_recording, save_calibration_picture
        from optdock.calibration import calibrate as found_in
        from optdock.io.atomic_file import write_text

        check_picture("--plot", plot)
        for log in logs:
            spare(log, write, report, plot)
        files = []
        with working("reading", len(logs)) as read:
            for log in logs:
                files.append(read_recording(log))
                read(log.name)
        deviations = [one.deviation for one in files if one.deviation is not None]
        found = found_in([one.recording for one in files], deviations, coverage=coverage / 100.0)
        text = as_text(found)
        typer.echo(text)
        if report is not None:
            write_text(report, text + "\n")
        if write is not None:
            write_text(write, as_yaml(found))
        if plot is not None:
            save_calibration_picture(plot, found)
        written = [str(file) for file in (write, report, plot) if file is not None]
        if written:
            typer.echo(f"written: {', '.join(written)}")
