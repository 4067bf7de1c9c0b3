"""The URDF of a gantry crane as a ROS 2 package has it, with a hook that cannot swing."""

from __future__ import annotations

GANTRY = """<robot name="gantry">
  <link name="rails"/>
  <link name="portal"><inertial><mass value="30000"/>
    <inertia ixx="1e6" iyy="1e6" izz="1e6" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="trolley"><inertial><mass value="3000"/>
    <inertia ixx="1e3" iyy="1e3" izz="1e3" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="hook"><inertial><mass value="300"/>
    <inertia ixx="20" iyy="20" izz="20" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="portal_joint" type="prismatic"><parent link="rails"/><child link="portal"/>
    <axis xyz="0 1 0"/><limit lower="0" upper="60" effort="4e4" velocity="1"/></joint>
  <joint name="cross_joint" type="prismatic"><parent link="portal"/><child link="trolley"/>
    <origin xyz="0 0 9"/><axis xyz="1 0 0"/>
    <limit lower="-8" upper="8" effort="8e3" velocity="1"/><dynamics friction="100"/></joint>
  <joint name="lift_joint" type="prismatic"><parent link="trolley"/><child link="hook"/>
    <origin xyz="0 0 -8"/><axis xyz="0 0 1"/>
    <limit lower="0" upper="6.5" effort="6e4" velocity="0.5"/></joint>
  <ros2_control name="gantry" type="system">
    <hardware><plugin>mock_components/GenericSystem</plugin></hardware>
    <joint name="portal_joint"><command_interface name="velocity"/>
      <state_interface name="position"><param name="initial_value">10</param></state_interface>
    </joint>
    <joint name="cross_joint"><command_interface name="velocity"/></joint>
    <joint name="lift_joint"><command_interface name="velocity"/>
      <state_interface name="position"><param name="initial_value">2</param></state_interface>
    </joint>
  </ros2_control>
</robot>"""
"""Portal along +Y, trolley along +X with dry friction, hook upwards from 8 m below the trolley, and
drives that take velocities."""
