"""Compiled kernels on points: grids, neighbours, voxels, components, rigid transforms."""
