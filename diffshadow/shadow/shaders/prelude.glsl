#define shadow_select(no, yes, condition) ((condition) ? (yes) : (no))

ivec2 shadow_size(sampler2D map) { return textureSize(map, 0); }

float shadow_fetch(sampler2D map, ivec2 texel) { return texelFetch(map, texel, 0).r; }

vec4 shadow_times(mat4 matrix, vec4 vector) { return matrix * vector; }

vec3 shadow_window(vec4 clip) { return clip.xyz / clip.w * 0.5 + 0.5; }

ivec2 shadow_texture_size(ShadowTexture image) { return textureSize(image, 0); }

vec4 shadow_texel(ShadowTexture image, ivec2 texel) { return texelFetch(image, texel, 0); }
