"""The crane in gz sim under ros2_control: efforts on the drives by /drives/commands, all joints on
/joint_states. Until the first command the drives exert the initial values of their effort
interfaces in urdf/crane.urdf, which hold the crane where it starts.
"""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch_ros.actions import Node

SHARE = Path(__file__).resolve().parents[1]


def generate_launch_description():
    """Launch the world with the crane, its clock and its controllers."""
    controllers = SHARE / "config" / "controllers.yaml"
    urdf = (SHARE / "urdf" / "crane.urdf").read_text().replace("CONTROLLERS_YAML", str(controllers))
    simulator = Path(get_package_share_directory("ros_gz_sim"), "launch", "gz_sim.launch.py")
    world = IncludeLaunchDescription(
        PythonLaunchDescriptionSource(str(simulator)),
        launch_arguments={"gz_args": f"-r {SHARE / 'worlds' / 'crane.sdf'}"}.items(),
    )
    publisher = Node(
        package="robot_state_publisher",
        executable="robot_state_publisher",
        parameters=[{"robot_description": urdf, "use_sim_time": True}],
    )
    crane = Node(
        package="ros_gz_sim",
        executable="create",
        arguments=["-topic", "robot_description", "-name", "crane"],
    )
    clock = Node(
        package="ros_gz_bridge",
        executable="parameter_bridge",
        arguments=["/clock@rosgraph_msgs/msg/Clock[gz.msgs.Clock"],
    )
    spawners = [
        Node(package="controller_manager", executable="spawner", arguments=[name])
        for name in ("joint_state_broadcaster", "drives")
    ]
    return LaunchDescription([world, publisher, crane, clock, *spawners])
