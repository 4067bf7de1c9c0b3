"""Exporters: a crane, or a run, as files for other programs.

An exporter writes a crane, or a run, for another program. It is a module with

* ``TARGET``, the name of its target in the help, such as "DIR";
* ``add_arguments(parser)``, which adds its arguments beside the target and the crane;
* ``run(options)``, which writes to ``options.target`` and returns it.
  `cranedyn.model.options.crane_from_options` loads the crane that the command line names;
  `target.new_folder` and `target.new_file` write all or nothing;
* optionally ``next_commands(options)``, which returns the two most useful command lines for what
  `run` has written. The command prints them.

The first paragraph of its docstring is its help. Its name is an entry point of the group
``cranedyn.exporters``, see `cranedyn.plugins`; ``cranedyn export --help`` lists all exporters.

Public names:
    `mjcf_file.export`, `ros2.export`, `fmi.export`, `mcap.export`, `gazebo.export`,
    `c_code.export`, `st.export`: the exporters.
    `controller_block.PARTS`: the controllers that code can have.
    `gazebo.Program`: a run for Gazebo, its controller as tables.

Begin with `mjcf_file`, the shortest exporter; docs/howto/export.md says what each carries.
"""
