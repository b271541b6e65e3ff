"""The configuration that the tests of pages show."""

TINY = """
name: tiny
scene:
  meshes:
    - {path: builtin:box, size: 1, drop_to_ground: true}
    - {path: builtin:plane, options: {size: 4}}
  camera: {resolution: [32, 48], eye: [2, 2.5, 3], target: [0, 0.4, 0]}
  light: {azimuth: -60, elevation: 50, angular_radius: 2}
shadow_map: {resolution: [64, 64]}
filter: {type: random_disk, radius: 1.5, samples: 4, pattern_size: 2}
reference: {samples: 16}
fit:
  parameters: {bias.constant: {lower: 0, upper: 8}, filter.radius: {lower: 0, upper: 8}}
  solver: {max_steps: 4}
  anneal: {phases: 1}
"""
