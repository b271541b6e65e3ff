"""Shaders: techniques in the languages of graphics APIs, for a renderer of one's own."""

from ._technique import shader_buffers as shader_buffers
from ._technique import to_shader as to_shader
