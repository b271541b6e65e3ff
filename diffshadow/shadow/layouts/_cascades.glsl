ShadowView shadow_cascade(sampler2D map, mat4 world_to_eye, mat4 eye_to_clip, int layer) {
    ShadowView view = shadow_view(map, world_to_eye, eye_to_clip, layer);
    if (SHADOW_SIDES[layer] > 0.0) {
        view.size = vec2(SHADOW_SIDES[layer], SHADOW_SIDES[layer]);
    }
    return view;
}

// How far inside the margin of a cascade a point lies, in half widths of the cascade; negative outside of it.
float shadow_to_border(ShadowView view, vec3 position) {
    vec4 place = shadow_project(view, position);
    vec2 from_middle = abs(vec2(2.0 * place.x / view.size.x - 1.0, 2.0 * place.y / view.size.y - 1.0));
    float margin = 2.0 * SHADOW_CASCADE_MARGIN;
    return min(1.0 - margin / view.size.x - from_middle.x, 1.0 - margin / view.size.y - from_middle.y);
}

// Visibility of the light at a point of a surface: 1 lit, 0 shadowed.
//
// map: the shadow map's window depths, 1 where it is empty; cascades lie one above the other
// world_to_eye, eye_to_clip: the light's matrices, with which the cascades were drawn
// position: of the surface in world units; normal: of its plane, of length 1, not interpolated
// to_light: unit vector from there to the light
// pixel: counted from the picture's lower left pixel, which is (0, 0); only patterns use it
// depth: distance of the surface along the camera's axis, in world units
float shadow(SHADOW_MAPS, mat4 world_to_eye, mat4 eye_to_clip[SHADOW_LAYERS], vec3 position, vec3 normal, vec3 to_light, vec2 pixel, float depth) {
    // A surface that faces away from the light is dark, however much shadows fade.
    if (!(dot(normal, to_light) > 0.0)) {
        return 0.0;
    }
    mat4 each[SHADOW_LAYERS] = eye_to_clip;
    int last = SHADOW_LAYERS - 1;
    int layer = 0;
    if (SHADOW_SELECTS_BY_MAP) {
        layer = last;
        for (int k = last - 1; k >= 0; k--) {
            if (shadow_to_border(shadow_cascade(map, world_to_eye, each[k], k), position) >= 0.0) {
                layer = k;
            }
        }
    } else {
        for (int k = 0; k < last; k++) {
            if (depth > SHADOW_ENDS[k]) {
                layer += 1;
            }
        }
    }
    int other = min(layer + 1, last);
    // The part of its own cascade in the mean of both.
    float part = 1.0;
    if (SHADOW_BLENDS && layer < last) {
        float from_end = (SHADOW_ENDS[layer] - depth) / (SHADOW_ENDS[layer] - SHADOW_BEGINS[layer]);
        bool overlaps = true;
        if (SHADOW_SELECTS_BY_MAP) {
            from_end = shadow_to_border(shadow_cascade(map, world_to_eye, each[layer], layer), position);
            overlaps = shadow_to_border(shadow_cascade(map, world_to_eye, each[other], other), position) >= 0.0;
        }
        if (overlaps) {
            part = clamp(from_end / SHADOW_BLEND, 0.0, 1.0);
        }
    }
    float lit = 0.0;
    for (int i = 0; i < 2; i++) {
        int k = shadow_select(layer, other, i == 1);
        float share = shadow_select(part, 1.0 - part, i == 1);
        if (share > 0.0) {
            ShadowView view = shadow_cascade(map, world_to_eye, each[k], k);
            lit += share * shadow_in_view(shadow_maps, view, position, normal, to_light, pixel);
        }
    }
    float strength = 1.0;
    if (SHADOW_ENDS_SHADOWS) {
        strength = clamp((SHADOW_ENDS[last] - depth) / SHADOW_FADE, 0.0, 1.0);
    }
    return 1.0 - strength * (1.0 - lit);
}
