"""Leads: effects that other results speak for, tried beside those that a diagnosis screens.

``physid monitor`` dates a step of a stiffness over all instants at once, ``physid fit --method lmi --varying``
follows one: a screening sees a step from a few instants alone.  What they found is where a refit starts;
then a lead is judged like every other candidate.  Its values are data, whoever wrote the file, and checked as such.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Any

from physid.criticism.base import Base
from physid.criticism.refit import Refit, Start, refit
from physid.effects.catalogue import check_place, check_value, effect_named, places_of
from physid.errors import InputError
from physid.identification.screening import is_in_model
from physid.identification.study import Study
from physid.plant.effect import Placed, Scales
from physid.plant.model import Model
from physid.plant.structure import Place

MOST = 20
"""Leads at most: each costs a refit."""
LONGEST = 200
"""Characters of a name."""
SOURCES = {"physid.monitoring/1": "physid monitor", "physid.fit/1": "physid fit --method lmi"}
"""Results that speak for effects, by their schema."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Lead:
    """An effect with the values another result found, and the command it comes from."""

    placed: Placed
    source: str


def read_leads(model: Model, results: Sequence[Mapping[str, Any]]) -> tuple[Lead, ...]:
    """Return the effects that results speak for, none where nothing was found.

    Parameters
    ----------
    model : Model
    results : sequence of mapping
        Of the schemas in :data:`SOURCES`.

    Raises
    ------
    InputError
        If a result is of another kind, or an effect, its place or a value is not one of this model's.
    """
    leads = tuple(
        Lead(placed=_placed(model, entry, source), source=source)
        for result in results
        for entry, source in _entries(result)
    )
    if len(leads) > MOST:
        raise InputError(f"The evidence speaks for {len(leads)} effects; give at most {MOST}.")
    return leads


def silence_notes(results: Sequence[Mapping[str, Any]]) -> tuple[str, ...]:
    """Say which of the results, read before by :func:`read_leads`, speak for no effect."""
    silent = [SOURCES[result["schema"]] for result in results if not _entries(result)]
    return tuple(dict.fromkeys(f"The evidence of {s} speaks for no effect." for s in silent))


def _entries(result: Mapping[str, Any]) -> list[tuple[object, str]]:
    """Return the effects in a result, each with the command that it comes from."""
    schema = result.get("schema") if isinstance(result, Mapping) else None
    source = SOURCES.get(schema) if isinstance(schema, str) else None
    if source is None:
        raise InputError(
            f"Evidence is the result of {' or '.join(SOURCES.values())}; this one has the schema "
            f"{_shown(schema)}."
        )
    if schema == "physid.monitoring/1":
        return [(entry, source) for entry in _listed(result, "evidence", source)]
    varying = _listed(result, "varying", source)
    return [(e, source) for v in varying for e in _listed(v, "effects", source)]


def _listed(holder: object, key: str, source: str) -> list[Any]:
    found = holder.get(key) if isinstance(holder, Mapping) else None
    if not isinstance(found, (list, tuple)):
        raise InputError(f"Evidence of {source} holds no list '{key}'; give the file it wrote.")
    return list(found)


def _placed(model: Model, entry: object, source: str) -> Placed:
    """Read {"effect", "location", "parameters": [{"name", "value"}, ...]}; all values are needed."""
    effect = effect_named(_text(entry, "effect", source))
    place = model.structure.find(_text(entry, "location", source), effect.kinds)
    values: dict[str, float] = {}
    for row in _listed(entry, "parameters", source):
        name = _text(row, "name", source)
        check_value(effect, name, _number(row, f"{effect.name}: {name}", source))
        if name in values:
            raise InputError(f"Evidence of {source} gives {effect.name} the value '{name}' twice.")
        values[name] = float(row["value"])
    missing = [c.name for c in effect.coefficients if c.name not in values]
    if missing:
        raise InputError(f"Evidence of {source} gives {effect.name} no value '{missing[0]}'.")
    placed = Placed(effect, place, values)
    check_place(model, placed)
    return placed


def _text(holder: object, key: str, source: str) -> str:
    found = holder.get(key) if isinstance(holder, Mapping) else None
    if not isinstance(found, str) or not found.isprintable() or not 0 < len(found) <= LONGEST:
        raise InputError(
            f"Evidence of {source} holds {_shown(found)} where '{key}' should be a name."
        )
    return found


def _number(row: Mapping[str, object], what: str, source: str) -> float:
    found = row.get("value")
    try:
        if isinstance(found, (int, float)) and not isinstance(found, bool):
            return float(found)
    except OverflowError:
        pass
    raise InputError(f"Evidence of {source}: {what}={_shown(found)} is not a number.")


def _shown(value: object) -> str:
    """Return a value of a stranger's file as a sentence can hold it."""
    text = repr(value) if isinstance(value, (str, int, float, type(None))) else type(value).__name__
    return text if len(text) <= 60 else f"{text[:57]}..."


def possible_leads(study: Study, leads: Sequence[Lead]) -> list[Lead]:
    """Leave out what the model has already.

    Raises
    ------
    InputError
        If an effect acts from a time on that no record reaches.
    """
    duration = max(float(e.time[-1] - e.time[0]) for e in study.experiments)
    for lead in leads:
        time = lead.placed.values["time"] if lead.placed.effect.timed else 0.5 * duration
        if not 0.0 < time < duration:
            raise InputError(
                f"Evidence of {lead.source}: the change at {time:g} s lies outside the records, which last "
                f"{duration:g} s: give the record it was found in."
            )
    return [
        lead
        for lead in leads
        if not is_in_model(lead.placed.effect, lead.placed.place, study.problem)
    ]


def sites_of(model: Model, leads: Sequence[Lead]) -> set[tuple[str, Place]]:
    """Return every place at which the leads' sources may have looked for their effects."""
    effects = {lead.placed.effect.name: lead.placed.effect for lead in leads}
    return {
        (name, place)
        for name, effect in effects.items()
        for place in places_of(effect, model.nominal, model.structure)
    }


def lead_notes(model: Model, leads: Sequence[Lead], tried: Sequence[Lead]) -> tuple[str, ...]:
    """Say what was tried because another result spoke for it, and what its p-value does not count."""
    notes = []
    for lead in leads:
        what = f"{lead.placed.effect.name} at {model.structure.label(lead.placed.place)}"
        if lead in tried:
            notes.append(
                f"{what} was tried because {lead.source} speaks for it: where that saw these records, the "
                "p-value does not count its choice of values."
            )
        else:
            notes.append(
                f"{what}, which {lead.source} speaks for, is in the model already or contained in what it "
                "has free."
            )
    return tuple(dict.fromkeys(notes))


def led(base: Base, leads: Sequence[Lead], scales: Mapping[Place, Scales]) -> list[Refit]:
    """Refit every lead from the values it came with; ``scales`` says how large things are at its place.

    The model's own parameters start where they fit best without the effect, and at the model's values, to
    which a monitoring holds the record.
    """
    problem, estimate = base.problems["long"], base.fits["long"]
    found: list[Refit] = []
    ordered = sorted(leads, key=_site)
    for rank, (_, group) in enumerate(groupby(ordered, key=_site)):
        starts = [
            Start(lead.placed, theta)
            for lead in group
            for theta in (estimate.theta, problem.start())
        ]
        fit = refit(base, problem, starts, scales[starts[0].placed.place], rank=rank)
        found += [] if fit is None else [fit]
    return found


def _site(lead: Lead) -> tuple[str, str, str]:
    return lead.placed.effect.name, lead.placed.place.kind, lead.placed.place.name
