"""All planted faults, and the sample that CI takes of them."""

from __future__ import annotations

import datetime
import fnmatch
import random
from collections.abc import Sequence

from tests.mutations import (
    density,
    device,
    evaluation,
    importers,
    losses,
    methods,
    networks,
    rendering,
    training,
    web,
)
from tests.mutations.mutation import Mutation

AREAS = (methods, density, losses, networks, training, rendering, device, evaluation, importers, web)
MUTATIONS: tuple[Mutation, ...] = tuple(mutation for area in AREAS for mutation in area.MUTATIONS)


def drawn(count: int, day: datetime.date, mutations: Sequence[Mutation] = MUTATIONS) -> list[Mutation]:
    """`count` mutations for a day; consecutive days go through all of them in a shuffled order."""
    order = sorted(mutations, key=lambda mutation: mutation.name)
    random.Random(0).shuffle(order)
    first = day.toordinal() * count
    return [order[(first + offset) % len(order)] for offset in range(min(count, len(order)))]


def named(patterns: Sequence[str], mutations: Sequence[Mutation] = MUTATIONS) -> list[Mutation]:
    """The mutations whose name or file matches one of the patterns (`*` stands for anything)."""
    return [
        mutation
        for mutation in mutations
        if any(fnmatch.fnmatch(text, pattern) for text in (mutation.name, mutation.file) for pattern in patterns)
    ]
