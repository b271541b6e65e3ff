fn shadow_size(map: texture_depth_2d) -> vec2i { return vec2i(textureDimensions(map)); }

// Rows are counted from the bottom, as window coordinates are in the functions below; WebGPU stores the top row first.
fn shadow_fetch(map: texture_depth_2d, texel: vec2i) -> f32 {
    return textureLoad(map, vec2i(texel.x, shadow_size(map).y - 1 - texel.y), 0);
}

fn shadow_times(matrix: mat4x4f, vector: vec4f) -> vec4f { return matrix * vector; }

// WebGPU's clip space has depths from 0 to 1.
fn shadow_window(clip: vec4f) -> vec3f { return vec3f(clip.xy / clip.w * 0.5 + 0.5, clip.z / clip.w); }

fn shadow_texture_size(image: ShadowTexture) -> vec2i { return vec2i(textureDimensions(image)); }

fn shadow_texel(image: ShadowTexture, texel: vec2i) -> vec4f {
    return textureLoad(image, vec2i(texel.x, shadow_texture_size(image).y - 1 - texel.y), 0);
}
