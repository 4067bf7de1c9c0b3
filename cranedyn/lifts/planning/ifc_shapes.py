"""A program of its own, which reads the shapes of an IFC file: `ifcopenshell` ends its process at
some files. It is run by its path, knows nothing of this package, and writes NumPy's ``.npz`` to its
standard output; the last line of its standard error says what was wrong, or what it was at.
"""

from __future__ import annotations

import io
import sys
from typing import Any

import numpy as np

_NO_BODIES = ("IfcSpace", "IfcOpeningElement", "IfcAnnotation", "IfcGrid")
"""Kinds of products that nothing can collide with: rooms, openings, texts and grid lines."""

_MAX_PRODUCTS = 5000
"""Largest number of products with shapes."""

_MAX_NAME = 200
"""Number of characters after which a name is cut."""


def extract_shapes(path: str) -> dict[str, np.ndarray]:
    """Read the products that have triangles.

    Returns:
        Their names, how many corners and triangles each has, and the corners [m] and triangles of
        all, those of each product counted from zero.
    """
    import ifcopenshell
    import ifcopenshell.geom

    model = ifcopenshell.open(path)
    settings = ifcopenshell.geom.settings()
    settings.set("use-world-coords", True)
    products: list[Any] = []
    for product in model.by_type("IfcProduct"):
        is_body = not any(product.is_a(kind) for kind in _NO_BODIES)
        if product.Representation and is_body:
            products.append(product)
    if len(products) > _MAX_PRODUCTS:
        sys.exit(f"it has {len(products)} products with shapes; allowed are {_MAX_PRODUCTS}")
    names = []
    # Empty arrays first, since nothing cannot be concatenated.
    vertices = [np.empty((0, 3))]
    triangles = [np.empty((0, 3), dtype=int)]
    for product in products:
        name = f"{str(product.Name or product.is_a())[:_MAX_NAME]} #{product.id()}"
        # The last line says at which product the process ended, if it does.
        print(name.encode("unicode_escape").decode(), file=sys.stderr, flush=True)
        # What comes back depends on the settings; its types name all that could.
        created: Any = ifcopenshell.geom.create_shape(settings, product)
        shape = created.geometry
        if shape.faces:
            names.append(name)
            vertices.append(np.array(shape.verts).reshape(-1, 3))
            triangles.append(np.array(shape.faces, dtype=int).reshape(-1, 3))
    return {
        "names": np.array(names, dtype=str),
        "corners": np.array([len(corners) for corners in vertices[1:]]),
        "faces": np.array([len(faces) for faces in triangles[1:]]),
        "vertices": np.concatenate(vertices),
        "triangles": np.concatenate(triangles),
    }


if __name__ == "__main__":
    try:
        arrays = extract_shapes(sys.argv[1])
    except Exception as error:  # whatever a parser of a stranger's bytes raises
        sys.exit(f"it is no whole IFC file ({' '.join(str(error).split())})")
    content = io.BytesIO()  # a pipe cannot be sought in
    np.savez(content, allow_pickle=False, **arrays)  # type: ignore[arg-type]
    sys.stdout.buffer.write(content.getbuffer())
