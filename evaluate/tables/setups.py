"""Notes on how the runs behind a table were trained, and on every difference between runs that share a column."""

from __future__ import annotations

from collections.abc import Sequence

from evaluate.protocols.method_names import display_name
from evaluate.protocols.results import Evaluation
from evaluate.tables.study import Study
from ggavatar.training.registry import table_notes

COMPARED = ("preset", "length", "perceptual loss", "tracking")
"""Facts in which methods of one table should not differ unnoticed; changed settings are each method's own."""


def setup_notes(study: Study) -> list[str]:
    """What every method of the table stands for, and what its author says about it."""
    found = [_description(study, method) for method in study.methods if len(_setups(study, method)) == 1]
    return found + _method_notes(study)


def mixing_notes(study: Study) -> list[str]:
    """Differences in preset, length, features or settings between runs in one column, and between methods."""
    found = [_mixture(study, method) for method in study.methods if len(_setups(study, method)) > 1]
    return found + _differences_between_methods(study)


def _runs(study: Study, method: str) -> list[Evaluation]:
    return [e for e in study.evaluations if e.method == method]


def _setups(study: Study, method: str) -> list[str]:
    """The different setups of a method's runs, in words."""
    return list(dict.fromkeys(_in_words(e) for e in _runs(study, method)))


def _in_words(evaluation: Evaluation) -> str:
    """The setup of an evaluation; with the method's name on the command line if the label is another."""
    setup = evaluation.setup
    named = setup.method not in (None, evaluation.method)
    return f"method {setup.method}, {setup.describe()}" if named else setup.describe()


def _description(study: Study, method: str) -> str:
    return f"{display_name(method)}: {_setups(study, method)[0]}."


def _mixture(study: Study, method: str) -> str:
    """A note that runs of one method were not trained alike, with each of them."""
    runs = _runs(study, method)
    facts = [run.setup.facts for run in runs]
    names = list(dict.fromkeys(name for fact in facts for name in fact))
    differing = [name for name in names if len({fact.get(name) for fact in facts}) > 1] or ["origin"]
    several = any(len(study.runs(run.subject, method)) > 1 for run in runs)
    each = [f"{run.subject}{_seed(run) if several else ''} {_in_words(run)}" for run in runs]
    return (
        f"Not alike: runs of {display_name(method)} that differ in {_joined(differing)} stand together here: "
        f"{'; '.join(dict.fromkeys(each))}."
    )


def _seed(run: Evaluation) -> str:
    return "" if run.seed is None else f", seed {run.seed},"


def _differences_between_methods(study: Study) -> list[str]:
    """One note on the facts in which methods differ, if each was trained in one way only."""
    uniform = {m: _runs(study, m)[0].setup.facts for m in study.methods if len(_setups(study, m)) == 1}
    trained = {method: facts for method, facts in uniform.items() if facts}
    words = []
    for name in COMPARED:
        if len({facts[name] for facts in trained.values()}) > 1:
            listed = ", ".join(f"{display_name(method)} {facts[name]}" for method, facts in trained.items())
            words.append(f"{name} ({listed})")
    return [f"Not alike: the methods differ in {_joined(words)}."] if words else []


def _joined(words: Sequence[str]) -> str:
    return " and ".join(filter(None, (", ".join(words[:-1]), words[-1])))


def _method_notes(study: Study) -> list[str]:
    """Notes of the methods' files, such as deviations from the paper, each once."""
    named = dict.fromkeys((display_name(e.method), e.setup.method) for e in study.evaluations)
    found = (f"{label}: {note}" for label, method in named if method is not None for note in table_notes(method))
    return list(dict.fromkeys(found))
