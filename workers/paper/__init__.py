"""The published chain: DeLORA, GndNet, FlowStep3D, two-stage clustering, the camera's view."""
