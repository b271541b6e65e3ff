// The light's view that a layer of the map shows.
struct ShadowView {
    mat4 world_to_eye;
    mat4 eye_to_clip;
    vec2 warp;  // its strength, and the clip coordinate x of its centre; 0 without a warp
    vec2 size;  // width and height in texels
    int layer;  // of the map
};

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
    int layer;  // of the map
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

// The view of a layer without a warp.
ShadowView shadow_view(sampler2D map, mat4 world_to_eye, mat4 eye_to_clip, int layer) {
    ShadowView view;
    view.world_to_eye = world_to_eye;
    view.eye_to_clip = eye_to_clip;
    view.warp = vec2(0.0, 0.0);
    view.size = vec2(shadow_layer_size(map));
    view.layer = layer;
    return view;
}

// Warped clip coordinates: a perspective along y, which enlarges the map's lower end.
vec4 shadow_warped(vec4 clip, vec2 warp) {
    float away = warp.x * 0.5 * (clip.y + clip.w);
    return clip + away * vec4(warp.y, 1.0, 0.0, 1.0);
}

// Width and height of a texel in world units; under a perspective, at a distance of 1.
vec2 shadow_extent(ShadowView view, vec2 texel) {
    vec2 extent = vec2(2.0 / (view.eye_to_clip[0][0] * view.size.x), 2.0 / (view.eye_to_clip[1][1] * view.size.y));
    if (SHADOW_WARPED) {
        float most = 1.0 + view.warp.x;
        float divisor = most / (most - view.warp.x * clamp(texel.y / view.size.y, 0.0, 1.0));
        extent = vec2(extent.x * divisor, extent.y * divisor * divisor / most);
    }
    return extent;
}

// Where a point falls in the map, x and y in texels, and its window depth; w is 1 in front of the light and 0 behind it.
vec4 shadow_project(ShadowView view, vec3 position) {
    vec4 clip = shadow_times(view.eye_to_clip, shadow_times(view.world_to_eye, vec4(position, 1.0)));
    vec4 place = clip;
    if (SHADOW_WARPED) {
        place = shadow_warped(clip, view.warp);
    }
    if (place.w <= shadow_select(0.0, 0.001 * SHADOW_NEAR, SHADOW_PERSPECTIVE)) {
        return vec4(1.5 * view.size.x, 1.5 * view.size.y, 1.5, 0.0);
    }
    vec3 window = shadow_window(place);
    // A warp leaves depths as they are.
    return vec4(window.x * view.size.x, window.y * view.size.y, shadow_window(clip).z, 1.0);
}

ShadowReceiver shadow_receiver(sampler2D map, ShadowView view, vec3 position, vec3 normal, vec3 to_light) {
    ShadowReceiver at;
    vec3 eye = shadow_times(view.world_to_eye, vec4(position, 1.0)).xyz;
    float span = SHADOW_FAR - SHADOW_NEAR;
    float along = shadow_select(-eye.z, max(-eye.z, SHADOW_NEAR), SHADOW_PERSPECTIVE);
    at.position = position;
    at.normal = normal;
    at.cosine = dot(normal, to_light);
    vec4 place = shadow_project(view, position);
    at.texel = place.xy;
    at.depth = place.z;
    at.in_front = place.w > 0.0;
    vec2 extent = shadow_extent(view, at.texel) * shadow_select(1.0, along, SHADOW_PERSPECTIVE);
    at.texel_size = sqrt(extent.x * extent.y);
    float depth_slope = shadow_select(1.0 / span, SHADOW_FAR * SHADOW_NEAR / (span * along * along), SHADOW_PERSPECTIVE);
    at.depth_per_texel = at.texel_size * depth_slope;
    vec3 facing = shadow_times(view.world_to_eye, vec4(normal, 0.0)).xyz;
    vec3 ray = vec3(0.0, 0.0, -1.0);
    if (SHADOW_PERSPECTIVE) {
        ray = eye / along;
    }
    float towards = dot(facing, ray);
    float least = max(length(facing.xy) / 100.0, 1e-12);
    if (abs(towards) <= least) {
        towards = shadow_select(least, -least, towards < 0.0);
    }
    vec2 across = facing.xy;
    if (SHADOW_WARPED) {
        // Columns of a warped map lean towards its centre.
        float column = at.texel.x * 2.0 / view.size.x - 1.0;
        float lean = 0.5 * view.warp.x * (column - view.warp.y) * view.eye_to_clip[1][1] / view.eye_to_clip[0][0];
        across = vec2(across.x, across.y + lean * across.x);
    }
    at.slope = vec2(-across.x / towards * extent.x / at.texel_size, -across.y / towards * extent.y / at.texel_size);
    vec3 near_position = abs(position);
    vec3 near_eye = abs(eye);
    float reach = max(near_position.x, max(near_position.y, near_position.z)) + max(near_eye.x, max(near_eye.y, near_eye.z)) + max(view.size.x, view.size.y) * at.texel_size;
    float steepness = sqrt(1.0 + dot(at.slope, at.slope));
    at.rounding = 8.0 * 1.1920929e-07 * (1.0 + depth_slope * reach * steepness) + SHADOW_HALF_STEP;
    at.light_distance = (along - SHADOW_NEAR) / span;
    at.depth_range = span;
    at.stored = shadow_stored(map, view.layer, ivec2(floor(at.texel)));
    at.layer = view.layer;
    return at;
}
