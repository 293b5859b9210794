"""The answer first: one sentence, the figures that carry it, for page and terminal."""

from __future__ import annotations

from dataclasses import dataclass

from physid.report.notation import (
    given,
    p_value,
    percent,
    percent_pair,
    plural,
    quantity,
    short,
)
from physid.report.reading import Result, kind, mapping, mappings, number, numbers, text, worst
from physid.report.words import (
    capital,
    effect_meaning,
    effects_phrase,
    parameter_phrase,
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Fall:
    """The largest error over the channels before and after the added effects.

    Attributes
    ----------
    before, after : float
        nrmse, as a fraction of the measured signal's standard deviation.
    place : str
        On what it was measured: ``the test record``, ``the training records``.
    """

    before: float
    after: float
    place: str

    def sentence(self) -> str:
        """Write ``the error on the test record falls from 18 % to 1.1 %``."""
        before, after = percent_pair(self.before, self.after)
        if before == after:
            return f"the error on {self.place} stays at {after}"
        verb = "falls" if self.after < self.before else "rises"
        return f"the error on {self.place} {verb} from {before} to {after}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Summary:
    """What a reader must know within ten seconds.

    Attributes
    ----------
    headline : str
        The verdict in one sentence.
    detail : str
        One or two sentences more, may be empty.
    facts : tuple of (label, value)
        A few figures.
    tone : str
        ``good``, ``warn`` or ``plain``.
    """

    headline: str
    detail: str
    facts: tuple[tuple[str, str], ...]
    tone: str


def record_place(result: Result, role: str) -> str:
    """Name the records of a role: ``the test record`` or ``the 3 training records``."""
    count = sum(1 for r in mappings(result.get("records")) if r.get("role") == role)
    noun = "test record" if role == "test" else "training record"
    return f"the {noun}" if count < 2 else f"the {count} {noun}s"


def error_fall(result: Result) -> Fall | None:
    """Return how far the error fell, on test data where there are some.

    Returns
    -------
    Fall or None
        None where the result adds nothing.
    """
    if kind(result) == "refinement":
        steps = mappings(result.get("steps"))
        for role in ("test", "train") if len(steps) > 1 else ():
            before, after = worst(steps[0].get(role)), worst(steps[-1].get(role))
            if before and after:
                place = record_place(result, role)
                return Fall(before=before[1], after=after[1], place=place)
    if kind(result) == "diagnosis" and result.get("verdict") == "effect_missing":
        for candidate in mappings(result.get("candidates"))[:1]:
            before, after = (worst(candidate.get(f"nrmse_{x}")) for x in ("before", "after"))
            if before and after:
                place = "data kept aside"
                return Fall(before=before[1], after=after[1], place=place)
    return None


def worst_channel(result: Result) -> tuple[str, float] | None:
    """Return the channel with the largest nrmse over all records, and that nrmse."""
    found = {text(c.get("name")): c.get("nrmse") for c in mappings(result.get("channels"))}
    if not found:
        for record in mappings(result.get("records")):
            for channel in mappings(record.get("channels")):
                name, value = text(channel.get("name")), number(channel.get("nrmse"))
                found[name] = max(number(found.get(name)) or 0.0, value or 0.0)
    return worst(found)


def summarise(result: Result) -> Summary:
    """Return the answer of any result.

    Parameters
    ----------
    result : mapping
        A result dictionary of any schema.

    Returns
    -------
    Summary
        A result's own ``sentence`` is the headline where it carries one.
    """
    makers = {
        "refinement": _refinement,
        "diagnosis": _diagnosis,
        "check": _check,
        "fit": _fit,
        "comparison": _comparison,
        "simulation": _simulation,
        "catalogue": _catalogue,
        "tuning": _tuning,
        "monitoring": _monitoring,
    }
    summary = makers.get(kind(result), _comparison)(result)
    sentence = text(result.get("sentence")).strip()
    if not sentence:
        return summary
    return Summary(headline=sentence, detail=summary.detail, facts=summary.facts, tone=summary.tone)


def _added(result: Result) -> list[object]:
    """Return all effects a refinement added, in order."""
    steps = mappings(result.get("steps"))
    return [effect for step in steps for effect in mappings(step.get("added"))]


def _fall_facts(fall: Fall | None) -> list[tuple[str, str]]:
    """Return the error fall as a figure."""
    if fall is None:
        return []
    before, after = percent_pair(fall.before, fall.after)
    return [(f"Error on {fall.place}", f"{before} → {after}")]


def _effect_facts(effects: object) -> list[tuple[str, str]]:
    """Return the parameters of the first effect as figures, two at most."""
    for effect in mappings(effects)[:1]:
        found = [parameter_phrase(p) for p in mappings(effect.get("parameters"))[:2]]
        return [(f"{capital(effects_phrase([effect]))}", "; ".join(found))] if found else []
    return []


def _meanings(effects: object) -> str:
    """Return what each effect does, as one sentence."""
    found = [effect_meaning(text(effect.get("effect"))) for effect in mappings(effects)]
    kept = [meaning for meaning in dict.fromkeys(found) if meaning]
    return capital("; ".join(kept)) + "." if kept else ""


def _absent(effects: object) -> str:
    """Write ``Coulomb friction at load is missing from the model``."""
    verb = "is" if len(mappings(effects)) == 1 else "are"
    return f"{capital(effects_phrase(effects))} {verb} missing from the model"


def _verdict_sentence(result: Result) -> str:
    """Write a verdict that names no effect."""
    verdict = text(result.get("verdict"))
    if verdict == "nothing_missing":
        return "Nothing is missing from the model: what remains of the error is noise."
    if verdict == "unexplained":
        return "Something is missing from the model, and no effect in the catalogue explains it."
    return "An effect is missing from the model."


def _refinement(result: Result) -> Summary:
    """Summarise a refinement."""
    added, fall = _added(result), error_fall(result)
    remaining = text(result.get("remaining"))
    if added:
        headline = _absent(added)
        headline += f": with it, {fall.sentence()}." if fall and len(added) == 1 else ""
        headline += f": with them, {fall.sentence()}." if fall and len(added) > 1 else ""
        headline += "" if fall else "."
    else:
        headline = _verdict_sentence(result)
    steps = mappings(result.get("steps"))
    facts = _fall_facts(fall) + _effect_facts(added)
    values = [number(step.get("p_value")) for step in steps]
    known = [p for p in values if p is not None]
    facts += [("Evidence", p_value(max(known)))] if known else []
    facts += [("Still missing", _REMAINING[remaining])] if remaining in _REMAINING else []
    detail = _meanings(added)
    if remaining in _AFTERWARDS and added:
        detail += " " + _AFTERWARDS[remaining]
    good = remaining == "nothing_missing" or result.get("verdict") == "nothing_missing"
    return Summary(
        headline=headline,
        detail=detail.strip(),
        facts=tuple(facts),
        tone="good" if good else "warn",
    )


_AFTERWARDS = {
    "nothing_missing": "After that, the tests find nothing more.",
    "effect_missing": "Another effect is still missing.",
    "unexplained": "Something is still missing that no effect in the catalogue explains.",
}
_REMAINING = {
    "nothing_missing": "nothing found",
    "effect_missing": "another effect",
    "unexplained": "something outside the catalogue",
}


def _diagnosis(result: Result) -> Summary:
    """Summarise a diagnosis."""
    best = mapping(next(iter(mappings(result.get("candidates"))), {}))
    fall, facts, detail = error_fall(result), _fall_facts(error_fall(result)), ""
    headline = _verdict_sentence(result)
    if result.get("verdict") == "effect_missing" and best:
        effects = best.get("effects")
        headline = _absent(effects) + (f": with it, {fall.sentence()}." if fall else ".")
        facts += _effect_facts(effects)
        if number(best.get("p_value")) is not None:
            facts.append(("Evidence", p_value(number(best.get("p_value")))))
        detail = _meanings(effects)
        twins = indistinguishable(best.get("indistinguishable_from"))
        if twins:
            detail += f" These records cannot tell it from {twins}."
    tried = len(mappings(result.get("candidates")))
    facts += [("Candidates listed", str(tried))] if tried else []
    facts += _channel_facts(result) if fall is None else []
    tone = "good" if result.get("verdict") == "nothing_missing" else "warn"
    return Summary(headline=headline, detail=detail.strip(), facts=tuple(facts), tone=tone)


def indistinguishable(sets: object) -> str:
    """Write the sets of effects that the records cannot tell apart from a candidate."""
    if not isinstance(sets, list | tuple):
        return ""
    return " or ".join(phrase for phrase in (effects_phrase(group) for group in sets) if phrase)


def _channel_facts(result: Result) -> list[tuple[str, str]]:
    """Return the worst channel's error as figures."""
    found = worst_channel(result)
    if found is None:
        return []
    return [
        ("Largest error", percent(found[1])),
        ("On channel", found[0]),
        ("Fit of that channel", percent(1.0 - found[1])),
    ]


def coloured(result: Result) -> bool | None:
    """Tell whether any channel's residual is not noise; None where it was not tested."""
    flags: list[bool] = []
    for channel in mappings(result.get("channels")):
        white, correlated = channel.get("residual_white"), channel.get("input_correlated")
        flags += [not white] if isinstance(white, bool) else []
        flags += [correlated] if isinstance(correlated, bool) else []
    return any(flags) if flags else None


def _noise_sentence(result: Result) -> str:
    """Write whether the residual is noise."""
    flag = coloured(result)
    if flag is None:
        return ""
    if flag:
        return "The residual is not noise: it still contains something the model should explain."
    return "The residual looks like noise: the tests find nothing left to explain."


def _comparison(result: Result) -> Summary:
    """Summarise a comparison, and anything unknown that has channels."""
    found = worst_channel(result)
    headline = "The model was compared with the records."
    if found:
        headline = (
            f"The model misses the records by {percent(found[1])} on its worst channel, {found[0]}."
        )
    facts = _channel_facts(result)
    joints = {text(j.get("name")): j.get("share") for j in _joints(result)}
    if worst(joints):
        name, share = worst(joints) or ("", 0.0)
        facts.append(("Where it fails most", f"{name} ({percent(share)} of the error)"))
    tone = "warn" if coloured(result) else "plain"
    return Summary(headline=headline, detail=_noise_sentence(result), facts=tuple(facts), tone=tone)


def _joints(result: Result) -> list[Result]:
    """Return the shares of the error per joint."""
    return list(mappings(mapping(result.get("where")).get("joints")))


def _fit(result: Result) -> Summary:
    """Summarise a fit."""
    parameters, found = mappings(result.get("parameters")), worst_channel(result)
    headline = f"{plural(len(parameters), 'parameter')} fitted"
    headline += f": the worst channel, {found[0]}, misses by {percent(found[1])}." if found else "."
    status = text(result.get("status")) or text(mapping(result.get("status")).get("sentence"))
    unsure = [p for p in parameters if number(p.get("std_error")) is None]
    facts = _channel_facts(result)
    facts += [("Not identifiable", plural(len(unsure), "parameter"))] if unsure else []
    parts = (capital(status), text(result.get("sentence")), _noise_sentence(result))
    detail = " ".join(part for part in parts if part)
    tone = "warn" if coloured(result) else "plain"
    return Summary(headline=headline, detail=detail, facts=tuple(facts), tone=tone)


def _check(result: Result) -> Summary:
    """Summarise a check against known parameters."""
    parameters = mappings(result.get("parameters"))
    wrong = [text(p.get("name")) for p in parameters if p.get("holds") is not True]
    within = number(result.get("within"))
    margin = f" within {given(100 * within)} %" if within is not None else ""
    if result.get("holds") is True:
        subject = "The estimate agrees" if len(parameters) == 1 else "All estimates agree"
        headline = f"The check holds: {subject.lower()} with the truth{margin}."
    else:
        listed = ", ".join(wrong[:4]) + (" and others" if len(wrong) > 4 else "")
        verb = "deviates" if len(wrong) == 1 else "deviate"
        headline = f"The check fails: {len(wrong)} of {len(parameters)} estimates {verb}"
        headline += f" more than {given(100 * within)} %" if within is not None else ""
        headline += f" ({listed})." if listed else "."
    deviation = worst({k: abs(v) for k, v in numbers(_deviations(result)).items()})
    facts = [("Estimates that agree", f"{len(parameters) - len(wrong)} of {len(parameters)}")]
    if deviation:
        facts.append(("Largest deviation", f"{percent(deviation[1])} ({deviation[0]})"))
    facts += [("Allowed", f"{given(100 * within)} %")] if within is not None else []
    tone = "good" if result.get("holds") is True else "warn"
    return Summary(headline=headline, detail="", facts=tuple(facts), tone=tone)


def _simulation(result: Result) -> Summary:
    """Summarise a simulated record."""
    samples = number(result.get("samples"))
    model = text(result.get("model")).replace("\\", "/").rsplit("/", 1)[-1]
    length, count = quantity(number(result.get("duration")), "s"), short(samples)
    headline = f"Simulated {length} of {model or 'the model'} in {count} samples."
    facts = [("Time step", quantity(number(result.get("timestep")), "s"))]
    facts += [("Columns", str(len(mappings(result.get("columns")))))]
    return Summary(headline=headline, detail="", facts=tuple(facts), tone="plain")


def _catalogue(result: Result) -> Summary:
    """Summarise the catalogue."""
    effects = mappings(result.get("effects"))
    headline = f"The catalogue: {plural(len(effects), 'effect')} that a model may lack."
    detail = "Write one as EFFECT@LOCATION:parameter=value to add it by hand with --add."
    return Summary(headline=headline, detail=detail, facts=(), tone="plain")


def _tuning(result: Result) -> Summary:
    """Summarise a tuning; its own sentence is the headline."""
    certificate, cost = mapping(result.get("certificate")), mapping(result.get("cost"))
    facts = (
        ("Cost", f"{short(number(cost.get('before')))} → {short(number(cost.get('after')))}"),
        ("Constraint", text(result.get("constraint"))),
        ("Guaranteed distance from −1", short(number(certificate.get("guaranteed_modulus")))),
        ("Loop before, off the desired one by", percent(number(result.get("misfit_before")))),
    )
    tone = "good" if result.get("verdict") == "certified" else "warn"
    return Summary(headline="A gain was tuned.", detail="", facts=facts, tone=tone)


def _monitoring(result: Result) -> Summary:
    """Summarise a monitoring; its own sentence is the headline."""
    best = (*mappings(result.get("hypotheses")), {})[0]
    facts = (
        ("Chance without a change", p_value(number(result.get("p_value")))),
        ("Likeliest", text(best.get("parameter"))),
        ("Its probability", percent(number(best.get("probability")))),
    )
    tone = {"changed": "warn", "nothing_changed": "good"}.get(text(result.get("verdict")), "plain")
    return Summary(headline="A record was monitored.", detail="", facts=facts, tone=tone)


def _deviations(result: Result) -> dict[str, object]:
    """Return the relative deviation of every checked parameter."""
    return {text(p.get("name")): p.get("deviation") for p in mappings(result.get("parameters"))}
