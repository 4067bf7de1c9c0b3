"""What talks to other libraries and machines while a program runs.

Public names:

* `gymnasium.CraneEnv` and `sb3`: the task of moving a load without swing, to learn in, for any
  crane; `task` says what is commanded and rewarded, `load_view` what is observed. The same for a
  tower crane, with observations of its own: `gymnasium.TowerCraneEnv` and `tower_task`.
* `python_control.to_control`, `python_control.from_control`: linear models for python-control, and
  its feedback as a controller; `margins.margins` has stability margins.
* `controller_file.open_controller`: one's own controller from a file of Python, JSON or MATLAB.
* `bags.read_joint_states`: columns of a trajectory from a recording of ROS 1 or ROS 2.
* `commissioning`: a crane as a plant with drive words, behind OPC UA and Modbus.

Each needs an extra, which its error names. Files for other programs are written by
`cranedyn.export`.
"""
