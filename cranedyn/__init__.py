"""A tower-crane dynamics laboratory: one xacro URDF, Pinocchio, a plain loop, and every number explained."""
