// SHADOW_WEIGHTS are the weights of bilinear compares one texel apart along an axis, between two zeros.
float shadow_filter(SHADOW_MAPS, ShadowLookup at) {
    vec2 corner = floor(at.texel - vec2(0.5, 0.5));
    vec2 t = at.texel - vec2(0.5, 0.5) - corner;
    int reach = SHADOW_TEXELS / 2 - 1;
    ivec2 first = ivec2(corner) - ivec2(reach, reach);
    float lit = 0.0;
    for (int j = 0; j < SHADOW_TEXELS; j++) {
        float row = mix(SHADOW_WEIGHTS[j + 1], SHADOW_WEIGHTS[j], t.y);
        for (int i = 0; i < SHADOW_TEXELS; i++) {
            float part = row * mix(SHADOW_WEIGHTS[i + 1], SHADOW_WEIGHTS[i], t.x);
            lit += part * shadow_compared(map, at, first + ivec2(i, j));
        }
    }
    return lit;
}
