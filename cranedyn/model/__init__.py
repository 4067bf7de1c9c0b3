"""The crane as data: from a URDF to a Pinocchio model, joints by name, and numbers.

Public: `load.load_crane`, `crane.Crane`, `layout.Layout`, `description.describe` and `arguments`.

To read: `load` (the steps, in order, and checks of the numbers), `urdf` (checks of the file),
`joints` (drives, roles, payload), `springs` (and where a load hangs).
"""
