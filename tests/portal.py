"""A portal crane as a stranger describes it: no visuals, and joints with names of their own."""

from __future__ import annotations

from pathlib import Path

from cranedyn.model.crane import Crane
from cranedyn.model.load import load_crane

PORTAL = """<robot name="portal">
  <link name="rail"/>
  <link name="bridge"><inertial><mass value="8000"/>
    <inertia ixx="1e4" iyy="1e4" izz="1e4" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="cart"><inertial><mass value="600"/>
    <inertia ixx="20" iyy="20" izz="20" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="s1"><inertial><mass value="1"/>
    <inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="s2"><inertial><mass value="1"/>
    <inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="load"><inertial><mass value="2500"/>
    <inertia ixx="300" iyy="300" izz="300" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="bridge_joint" type="prismatic"><parent link="rail"/><child link="bridge"/>
    <origin xyz="0 0 12"/><axis xyz="1 0 0"/>
    <limit lower="0" upper="60" effort="5e4" velocity="1.5"/></joint>
  <joint name="cart_joint" type="prismatic"><parent link="bridge"/><child link="cart"/>
    <axis xyz="0 1 0"/><limit lower="-9" upper="9" effort="2e4" velocity="1"/></joint>
  <joint name="sx_joint" type="revolute"><parent link="cart"/><child link="s1"/>
    <axis xyz="0 1 0"/><limit lower="-1.2" upper="1.2" effort="1" velocity="10"/>
    <dynamics damping="20"/></joint>
  <joint name="sy_joint" type="revolute"><parent link="s1"/><child link="s2"/>
    <axis xyz="1 0 0"/><limit lower="-1.2" upper="1.2" effort="1" velocity="10"/>
    <dynamics damping="20"/></joint>
  <joint name="rope_joint" type="prismatic"><parent link="s2"/><child link="load"/>
    <axis xyz="0 0 {way}"/>
    <limit lower="{shortest}" upper="{longest}" effort="6e4" velocity="0.6"/></joint>
</robot>"""
"""Its URDF, with the sense of the rope joint and the range of its coordinate [m] left open."""


def portal_crane(folder: Path, *, upward: bool = False) -> Crane:
    """Write the URDF of the portal crane to a folder, and return the crane.

    Args:
        folder: The folder.
        upward: Whether the coordinate of the rope joint grows upwards, so that it is negative.
    """
    if upward:
        text = PORTAL.format(way=1, shortest=-11.0, longest=-2.0)
    else:
        text = PORTAL.format(way=-1, shortest=2.0, longest=11.0)
    file = folder / "portal.urdf"
    file.write_text(text, "utf-8")
    return load_crane(file, driven=["bridge_joint", "cart_joint", "rope_joint"])
