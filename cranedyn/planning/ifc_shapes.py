"""A program of its own, which reads the shapes of an IFC file: `ifcopenshell` ends its process at
some files. It is run by its path, knows nothing of this package, and writes NumPy's ``.npz`` to its
standard output; the last line of its standard error says what was wrong, or what it was at.
"""

from __future__ import annotations

import io
import sys

import numpy as np

_AIR = ("IfcSpace", "IfcOpeningElement", "IfcAnnotation", "IfcGrid")
_MOST_PRODUCTS = 5000
_LONGEST_NAME = 200


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
    products = [
        product
        for product in model.by_type("IfcProduct")
        if product.Representation and not any(map(product.is_a, _AIR))
    ]
    if len(products) > _MOST_PRODUCTS:
        sys.exit(f"it has {len(products)} products with shapes; allowed are {_MOST_PRODUCTS}")
    names, vertices, triangles = [], [np.empty((0, 3))], [np.empty((0, 3), dtype=int)]
    for product in products:
        name = f"{str(product.Name or product.is_a())[:_LONGEST_NAME]} #{product.id()}"
        print(name.encode("unicode_escape").decode(), file=sys.stderr, flush=True)
        shape = ifcopenshell.geom.create_shape(settings, product).geometry
        if shape.faces:
            names.append(name)
            vertices.append(np.array(shape.verts).reshape(-1, 3))
            triangles.append(np.array(shape.faces, dtype=int).reshape(-1, 3))
    return {
        "names": np.array(names, dtype=str),
        "corners": np.array([*map(len, vertices[1:])]),
        "faces": np.array([*map(len, triangles[1:])]),
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
