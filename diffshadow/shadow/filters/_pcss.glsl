// Half the width of the light's image through a blocker, in texels along the map's x and y.
vec2 shadow_penumbra(ShadowLookup at, float receiver, float blocker) {
    float width = max(receiver - blocker, 0.0) * SHADOW_LIGHT_SIZE;
    float scale = 1.0;
    if (SHADOW_PERSPECTIVE) {
        width = width / blocker;
        scale = receiver;
    }
    return vec2(width / (at.extent.x * scale), width / (at.extent.y * scale));
}

// A stored depth and its weight, the fraction of the light that it blocks.
vec2 shadow_blocker(sampler2D map, ShadowLookup at, ivec2 texel, float weight) {
    float blocks = weight * (1.0 - shadow_compared(map, at, texel));
    return vec2(blocks, blocks * shadow_stored(map, at.layer, texel));
}

float shadow_filter(SHADOW_MAPS, ShadowLookup at) {
    float turn = 6.28318531 * shadow_noise(at.pixel);
    float receiver = shadow_distance(at.depth);
    vec2 search = min(shadow_penumbra(at, receiver, SHADOW_NEAR), vec2(SHADOW_MAX_RADIUS, SHADOW_MAX_RADIUS));
    float angle = shadow_select(0.0, turn, SHADOW_SEARCH_ROTATED);
    int tile = SHADOW_SEARCH_PATTERN_SIZE * SHADOW_SEARCH_PATTERN_SIZE;
    int pixel = shadow_tile_pixel(at.pixel, SHADOW_SEARCH_PATTERN_SIZE);
    vec2 blockers = vec2(0.0, 0.0);
    for (int i = 0; i < SHADOW_SEARCH_SAMPLES; i++) {
        int index = 2 * (i * tile + pixel);
        vec2 offset = shadow_turned(vec2(SHADOW_SEARCH_PATTERN[index], SHADOW_SEARCH_PATTERN[index + 1]), angle);
        vec2 texel = at.texel + search * offset - vec2(0.5, 0.5);
        vec2 corner = floor(texel);
        vec2 t = texel - corner;
        ivec2 first = ivec2(corner);
        blockers += shadow_blocker(map, at, first, (1.0 - t.x) * (1.0 - t.y));
        blockers += shadow_blocker(map, at, first + ivec2(1, 0), t.x * (1.0 - t.y));
        blockers += shadow_blocker(map, at, first + ivec2(0, 1), (1.0 - t.x) * t.y);
        blockers += shadow_blocker(map, at, first + ivec2(1, 1), t.x * t.y);
    }
    // Fewer blockers than this count as none; it is above rounding error.
    if (blockers.x <= 0.00001 * float(SHADOW_SEARCH_SAMPLES)) {
        return 1.0;
    }
    vec2 width = shadow_penumbra(at, receiver, shadow_distance(blockers.y / blockers.x));
    vec2 radius = vec2(clamp(width.x, SHADOW_MIN_RADIUS, SHADOW_MAX_RADIUS), clamp(width.y, SHADOW_MIN_RADIUS, SHADOW_MAX_RADIUS));
    angle = shadow_select(0.0, turn, SHADOW_ROTATED);
    tile = SHADOW_PATTERN_SIZE * SHADOW_PATTERN_SIZE;
    pixel = shadow_tile_pixel(at.pixel, SHADOW_PATTERN_SIZE);
    float lit = 0.0;
    for (int i = 0; i < SHADOW_SAMPLES; i++) {
        int index = 2 * (i * tile + pixel);
        vec2 offset = shadow_turned(vec2(SHADOW_PATTERN[index], SHADOW_PATTERN[index + 1]), angle);
        lit += shadow_bilinear_tap(map, at, at.texel + radius * offset);
    }
    return lit / float(SHADOW_SAMPLES);
}
