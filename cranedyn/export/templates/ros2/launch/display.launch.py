"""Show the crane in RViz; its joints are moved by hand, or by what publishes /joint_states, such as
a recording played back.
"""

from pathlib import Path

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

SHARE = Path(__file__).resolve().parents[1]


def generate_launch_description():
    """Launch sliders, transforms and RViz."""
    description = {"robot_description": (SHARE / "urdf" / "crane.urdf").read_text()}
    by_hand = DeclareLaunchArgument(
        "sliders", default_value="true", description="whether sliders move the joints"
    )
    sliders = Node(
        package="joint_state_publisher_gui",
        executable="joint_state_publisher_gui",
        condition=IfCondition(LaunchConfiguration("sliders")),
    )
    publisher = Node(
        package="robot_state_publisher",
        executable="robot_state_publisher",
        parameters=[description],
    )
    rviz = Node(
        package="rviz2", executable="rviz2", arguments=["-d", str(SHARE / "rviz" / "crane.rviz")]
    )
    return LaunchDescription([by_hand, sliders, publisher, rviz])
