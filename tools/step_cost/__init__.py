"""The step-cost meter: what a control step costs on the target, counted and estimated without one."""
