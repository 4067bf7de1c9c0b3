"""The crane as data: from a URDF to numbers, joints by name, driven and passive."""
