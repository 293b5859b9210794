"""The options that commands share, each declared once.

`grouped` lets a command take a dataclass of options as one argument, so that a signature names
the groups it uses and not fifteen options.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_type_hints

import typer

from physid.cli.parsing import Bounds, Prior, parse_bounds, parse_fit, parse_map, parse_priors
from physid.errors import InputError

if TYPE_CHECKING:
    from physid.plant.model import Model

ADD = typer.Option(
    "--add",
    metavar="EFFECT@LOCATION[:PARAMETER=VALUE,...]",
    help="Add an effect by hand; parameters without a value are fitted. Repeatable.",
)
EFFECTS = typer.Option(
    "--effects",
    metavar="FILE",
    help="Your own effects: a .py, which is run as any script is, or a .toml with MJCF. Repeatable.",
)
HOLD = typer.Option(
    "--hold",
    metavar="zero|first|smooth|auto",
    help="The input between two samples: held, straight lines, or a smooth curve. Default: held, "
    "unless the record clearly says otherwise, which is then noted.",
)
MAP = typer.Option("--map", metavar="COLUMN=NAME", help="Rename a column. Repeatable.")
MODEL = typer.Argument(metavar="MODEL", help="An MJCF file. It is never written to.")
RECORDS = typer.Argument(metavar="RECORD", help="Measured runs of one rig, fitted jointly.")

HOLDS = ("zero", "first", "smooth", "auto")


@dataclass(frozen=True, slots=True, kw_only=True)
class Output:
    """Where a result goes, and how a computation runs."""

    as_json: Annotated[
        bool, typer.Option("--json", help="Print one JSON object alone on standard output.")
    ] = False
    out: Annotated[
        Path | None,
        typer.Option("--out", metavar="DIR", help="Write result.json and report.html there."),
    ] = None
    seed: Annotated[
        int, typer.Option("--seed", min=0, metavar="N", help="Seed of everything random.")
    ] = 0
    jobs: Annotated[
        int, typer.Option("--jobs", min=1, metavar="N", help="Processes to use at most.")
    ] = 1
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Show no progress.")] = False


@dataclass(frozen=True, slots=True, kw_only=True)
class Study:
    """A model, its records, and what may be changed to bring them together."""

    model: Annotated[Path, MODEL]
    records: Annotated[list[Path], RECORDS]
    fit: Annotated[
        str | None,
        typer.Option(
            "--fit",
            metavar="NAME,NAME,...|auto",
            help="The parameters to fit, such as hinge.damping,link.mass.",
        ),
    ] = None
    bounds: Annotated[
        list[str] | None,
        typer.Option(
            "--bounds", metavar="NAME=LOW:HIGH", help="Limits of a parameter. Repeatable."
        ),
    ] = None
    prior: Annotated[
        list[str] | None,
        typer.Option(
            "--prior", metavar="NAME=VALUE+-STD", help="Knowledge of a parameter. Repeatable."
        ),
    ] = None
    add: Annotated[list[str] | None, ADD] = None
    effects: Annotated[list[Path] | None, EFFECTS] = None
    hold: Annotated[str | None, HOLD] = None
    rename: Annotated[list[str] | None, MAP] = None

    def source(self) -> Model | Path:
        """Return the model as :func:`model_with` does."""
        return model_with(self.model, self.effects)

    def keywords(self, *, default_fit: str | None) -> dict[str, Any]:
        """Return the keyword options of the Python API.

        Parameters
        ----------
        default_fit : str or None
            What is fitted where ``--fit`` is not given.

        Raises
        ------
        InputError
            If an option cannot be read.
        """
        bounds: dict[str, Bounds] = parse_bounds(self.bounds or ())
        priors: dict[str, Prior] = parse_priors(self.prior or ())
        return {
            "fit": parse_fit(self.fit) if self.fit is not None else default_fit,
            "bounds": bounds,
            "priors": priors,
            "add": tuple(self.add or ()),
            "hold": checked_hold(self.hold),
            "rename": parse_map(self.rename or ()),
        }


def model_with(model: Path, effects: Sequence[Path] | None) -> Model | Path:
    """Return a model that knows the user's own effects; its path alone where there are none.

    Raises
    ------
    InputError
        If a file of effects, or the model, cannot be read.
    """
    if not effects:
        return model
    import physid

    return physid.load_model(model, physid.load_effects(*effects))


def checked_hold(hold: str | None) -> str | None:
    """Return `hold` if it is a kind of hold, or None where none is given.

    Raises
    ------
    InputError
        Naming the kinds there are.
    """
    if hold is not None and hold not in HOLDS:
        raise InputError(f"--hold '{hold}' is not a hold. Available: {', '.join(HOLDS)}.")
    return hold


def grouped(command: Callable[..., Any]) -> Callable[..., Any]:
    """Let a command take dataclasses of options as its arguments.

    Parameters
    ----------
    command : callable
        Its parameters are annotated with option dataclasses (`Study`, `Output`) or are single
        options.

    Returns
    -------
    callable
        The same command with every dataclass replaced by its fields, as Typer wants it.
    """
    hints = get_type_hints(command, include_extras=True)
    names = list(inspect.signature(command).parameters)
    groups = {name: hints[name] for name in names if is_dataclass(hints[name])}
    parameters = [
        parameter
        for name, original in inspect.signature(command).parameters.items()
        for parameter in (
            _fields_of(groups[name])
            if name in groups
            else [original.replace(annotation=hints[name], kind=inspect.Parameter.KEYWORD_ONLY)]
        )
    ]

    @wraps(command)
    def flat(**values: Any) -> Any:
        return command(**_gather(values, names, groups))

    flat.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    flat.__annotations__ = {p.name: p.annotation for p in parameters}
    return flat


def _fields_of(group: type) -> Sequence[inspect.Parameter]:
    hints = get_type_hints(group, include_extras=True)
    return [
        inspect.Parameter(
            field.name,
            inspect.Parameter.KEYWORD_ONLY,
            annotation=hints[field.name],
            default=parameter.default,
        )
        for field, parameter in zip(
            fields(group), inspect.signature(group).parameters.values(), strict=True
        )
    ]


def _gather(
    values: Mapping[str, Any], names: Sequence[str], groups: Mapping[str, type]
) -> dict[str, Any]:
    return {
        name: groups[name](**{f.name: values[f.name] for f in fields(groups[name])})
        if name in groups
        else values[name]
        for name in names
    }
