"""Published chain of the paper: DeLORA, GndNet, FlowStep3D, two-stage clustering, camera view."""
