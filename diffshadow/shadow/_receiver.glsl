// The receiver as the light sees it.
struct ShadowReceiver {
    vec3 position;  // world units
    vec3 normal;  // unit length
    float cosine;  // of the angle between the normal and the direction to the light
    vec2 texel;  // where it falls in the map, in texels from the lower left corner
    float depth;  // window depth
    bool in_front;  // of the light
    float texel_size;  // width of a texel there, in world units
    float depth_per_texel;  // change of window depth over that length along the light's axis
    vec2 slope;  // of the receiver's plane along the map's x and y, in texel widths per texel
    float rounding;  // bound on the error of depth, in window depth
    float light_distance;  // along the light's axis, 0 at the map's near plane and 1 at its far plane
    float depth_range;  // from the near to the far plane, in world units
    float stored;  // window depth in the map at the receiver's own texel
};

// Width and height in texels of a layer. A map of several has the first one at its lower end.
ivec2 shadow_layer_size(sampler2D map) {
    ivec2 size = shadow_size(map);
    return ivec2(size.x, size.y / SHADOW_LAYERS);
}

// The depth in a texel, and 1 beyond the layer.
float shadow_stored(sampler2D map, int layer, ivec2 texel) {
    ivec2 size = shadow_layer_size(map);
    if (texel.x < 0 || texel.y < 0 || texel.x >= size.x || texel.y >= size.y) {
        return 1.0;
    }
    return shadow_fetch(map, ivec2(texel.x, texel.y + layer * size.y));
}

// Width and height of a texel in world units; under a perspective, at a distance of 1.
vec2 shadow_extent(mat4 eye_to_clip, sampler2D map) {
    vec2 size = vec2(shadow_layer_size(map));
    return vec2(2.0 / (eye_to_clip[0][0] * size.x), 2.0 / (eye_to_clip[1][1] * size.y));
}

// Where a point falls in the map, x and y in texels, and its window depth; w is 1 in front of the light and 0 behind it.
vec4 shadow_project(sampler2D map, mat4 world_to_eye, mat4 eye_to_clip, vec3 position) {
    vec4 clip = shadow_times(eye_to_clip, shadow_times(world_to_eye, vec4(position, 1.0)));
    vec2 size = vec2(shadow_layer_size(map));
    if (clip.w <= shadow_select(0.0, 0.001 * SHADOW_NEAR, SHADOW_PERSPECTIVE)) {
        return vec4(1.5 * size.x, 1.5 * size.y, 1.5, 0.0);
    }
    vec3 window = shadow_window(clip);
    return vec4(window.x * size.x, window.y * size.y, window.z, 1.0);
}

ShadowReceiver shadow_receiver(sampler2D map, int layer, mat4 world_to_eye, mat4 eye_to_clip, vec3 position, vec3 normal, vec3 to_light) {
    ShadowReceiver at;
    vec3 eye = shadow_times(world_to_eye, vec4(position, 1.0)).xyz;
    vec2 size = vec2(shadow_layer_size(map));
    float span = SHADOW_FAR - SHADOW_NEAR;
    float along = shadow_select(-eye.z, max(-eye.z, SHADOW_NEAR), SHADOW_PERSPECTIVE);
    at.position = position;
    at.normal = normal;
    at.cosine = dot(normal, to_light);
    vec4 place = shadow_project(map, world_to_eye, eye_to_clip, position);
    at.texel = place.xy;
    at.depth = place.z;
    at.in_front = place.w > 0.0;
    vec2 extent = shadow_extent(eye_to_clip, map) * shadow_select(1.0, along, SHADOW_PERSPECTIVE);
    at.texel_size = sqrt(extent.x * extent.y);
    float depth_slope = shadow_select(1.0 / span, SHADOW_FAR * SHADOW_NEAR / (span * along * along), SHADOW_PERSPECTIVE);
    at.depth_per_texel = at.texel_size * depth_slope;
    vec3 facing = shadow_times(world_to_eye, vec4(normal, 0.0)).xyz;
    vec3 ray = vec3(0.0, 0.0, -1.0);
    if (SHADOW_PERSPECTIVE) {
        ray = eye / along;
    }
    float towards = dot(facing, ray);
    float least = max(length(facing.xy) / 100.0, 1e-12);
    if (abs(towards) <= least) {
        towards = shadow_select(least, -least, towards < 0.0);
    }
    at.slope = vec2(-facing.x / towards * extent.x / at.texel_size, -facing.y / towards * extent.y / at.texel_size);
    vec3 near_position = abs(position);
    vec3 near_eye = abs(eye);
    float reach = max(near_position.x, max(near_position.y, near_position.z)) + max(near_eye.x, max(near_eye.y, near_eye.z)) + max(size.x, size.y) * at.texel_size;
    float steepness = sqrt(1.0 + dot(at.slope, at.slope));
    at.rounding = 8.0 * 1.1920929e-07 * (1.0 + depth_slope * reach * steepness) + SHADOW_HALF_STEP;
    at.light_distance = (along - SHADOW_NEAR) / span;
    at.depth_range = span;
    at.stored = shadow_stored(map, layer, ivec2(floor(at.texel)));
    return at;
}
