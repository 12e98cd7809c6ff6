"""Geometry that every stage may use: rigid transforms and spherical range images."""
