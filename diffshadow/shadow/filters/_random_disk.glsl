// The mean of compares at some points of the pattern, scaled to the disk: from the first, and before the last one.
float shadow_mean_of_taps(sampler2D map, ShadowLookup at, int first, int last) {
    int tile = SHADOW_PATTERN_SIZE * SHADOW_PATTERN_SIZE;
    int pixel = shadow_tile_pixel(at.pixel, SHADOW_PATTERN_SIZE);
    float angle = shadow_select(0.0, 6.28318531 * shadow_noise(at.pixel), SHADOW_ROTATED);
    float lit = 0.0;
    for (int i = first; i < last; i++) {
        int index = 2 * (i * tile + pixel);
        vec2 offset = shadow_turned(vec2(SHADOW_PATTERN[index], SHADOW_PATTERN[index + 1]), angle);
        vec2 texel = at.texel + vec2(SHADOW_RADIUS * offset.x, SHADOW_RADIUS * offset.y);
        if (SHADOW_BILINEAR) {
            lit += shadow_bilinear_tap(map, at, texel);
        } else {
            lit += shadow_nearest_tap(map, at, texel);
        }
    }
    return lit / float(last - first);
}

float shadow_filter(SHADOW_MAPS, ShadowLookup at) {
    if (SHADOW_EARLY_SAMPLES == 0) {
        return shadow_mean_of_taps(map, at, 0, SHADOW_SAMPLES);
    }
    float first = shadow_mean_of_taps(map, at, 0, SHADOW_EARLY_SAMPLES);
    if (first == 0.0 || first == 1.0) {
        return first;
    }
    float others = shadow_mean_of_taps(map, at, SHADOW_EARLY_SAMPLES, SHADOW_SAMPLES);
    return mix(others, first, float(SHADOW_EARLY_SAMPLES) / float(SHADOW_SAMPLES));
}
