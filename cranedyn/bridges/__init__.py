"""Bridges to other programs: exporters, recordings of ROS, Gymnasium, python-control.

An exporter writes a crane, or a run, for another program. It is a module with

* ``TARGET``, the name of its target in the help, such as "DIR";
* ``add_arguments(parser)``, which adds its arguments beside the target and the crane;
* ``run(options)``, which writes to ``options.target`` and returns it.
  `cranedyn.model.options.crane_from_options` loads the crane that the command line names;
  `target.new_folder` and `target.new_file` write all or nothing.

The first paragraph of its docstring is its help. Its name is an entry point of the group
``cranedyn.exporters``, see `cranedyn.plugins`; ``cranedyn export --help`` lists all exporters.

Public names:
    `mjcf.export`, `ros2.export`, `fmi.export`, `mcap.export`, `gazebo.export`, `c_code.export`,
    `st.export`: the exporters. `controller_block.PARTS` lists the controllers that code can have.
    `gazebo.Program`: a run for Gazebo, its controller as tables.
    `bags.read_joint_states`: columns of a trajectory from a recording of ROS 1 or ROS 2.
    `gymnasium.TowerCraneEnv`: the crane as an environment to learn in.
    `control.to_control`, `margins.margins`: models for python-control, and stability margins.
    `commissioning`: the crane behind OPC UA and Modbus.

Begin with `mjcf`, the shortest exporter; docs/howto/export.md says what each carries.
"""
