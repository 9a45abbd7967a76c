"""Model files of FLAME's layout and classes, with made-up numbers."""

from __future__ import annotations

import pickle
import sys
import types

import numpy as np


def chumpy_pickle(values: dict[str, object], protocol: int = 2) -> bytes:
    """A pickle with chumpy's and old scipy's class names, made with modules that exist only while it is written."""
    made = {}
    for name in ("chumpy", "chumpy.ch", "chumpy.reordering", "scipy.sparse.csc"):
        made[name] = types.ModuleType(name)
    ch = type("Ch", (), {"__module__": "chumpy.ch"})
    select = type("Select", (), {"__module__": "chumpy.reordering"})
    matrix = type("csc_matrix", (), {"__module__": "scipy.sparse.csc"})
    made["chumpy.ch"].Ch, made["chumpy.reordering"].Select, made["scipy.sparse.csc"].csc_matrix = ch, select, matrix
    saved = {name: sys.modules.get(name) for name in made}
    sys.modules.update(made)
    try:
        content = {}
        for key, value in values.items():
            content[key] = value
            if isinstance(value, tuple):
                kind, state = value
                content[key] = {"ch": ch, "select": select, "csc": matrix}[kind]()
                content[key].__dict__.update(state)
        return pickle.dumps(content, protocol)
    finally:
        for name, module in saved.items():
            if module is None:
                sys.modules.pop(name, None)
            else:
                sys.modules[name] = module


VERTICES, FACES = 40, 60


def flame_values(seed: int = 0) -> dict[str, np.ndarray]:
    generator = np.random.default_rng(seed)
    weights = generator.uniform(0, 1, (VERTICES, 5))
    regressor = generator.uniform(0, 1, (5, VERTICES))
    return {
        "v_template": generator.normal(0, 0.1, (VERTICES, 3)),
        "f": generator.integers(0, VERTICES, (FACES, 3)).astype(np.uint32),
        "weights": weights / weights.sum(axis=1, keepdims=True),
        "posedirs": generator.normal(0, 0.001, (VERTICES, 3, 36)),
        "shapedirs": generator.normal(0, 0.002, (VERTICES, 3, 400)),
        "J_regressor": regressor / regressor.sum(axis=1, keepdims=True),
        "kintree_table": np.array([[4294967295, 0, 1, 1, 1], [0, 1, 2, 3, 4]], dtype=np.uint32),
    }


def write_model(path, values):
    """As the official file: shapedirs as chumpy, the regressor sparse, the rest plain; protocol 2."""
    import scipy.sparse

    sparse = scipy.sparse.csc_matrix(values["J_regressor"])
    state = {"_shape": sparse.shape, "data": sparse.data, "indices": sparse.indices, "indptr": sparse.indptr}
    stored = {**values, "shapedirs": ("ch", {"x": values["shapedirs"]}), "J_regressor": ("csc", state)}
    path.write_bytes(chumpy_pickle({**stored, "bs_type": "lrotmin", "bs_style": "lbs"}))
