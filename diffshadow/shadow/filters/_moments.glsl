vec4 shadow_moments(float depth) {
    float w = 2.0 * depth - 1.0;
    return vec4(w, w * w, w * w * w, w * w * w * w);
}

// The least mass below z of any distribution with the moments b: that of masses at z and at two more depths, which are the
// roots of c.x + c.y x + c.z x^2 (Peters & Klein 2015, algorithm 3).
float shadow_least(vec4 b, float z) {
    float d22 = max(b.y - b.x * b.x, SHADOW_ROUNDING);
    float l32_d22 = b.z - b.x * b.y;
    float l32 = l32_d22 / d22;
    float d33 = max(b.w - b.y * b.y - l32 * l32_d22, SHADOW_ROUNDING);
    float y2 = z - b.x;
    float y3 = z * z - b.y - l32 * y2;
    float c3 = y3 / d33;
    float c2 = y2 / d22 - l32 * c3;
    float c1 = 1.0 - c2 * b.x - c3 * b.y;
    float at_z = 1.0 / (1.0 + y2 * y2 / d22 + y3 * y3 / d33);
    // A root at infinity has no mass.
    float leading = shadow_select(c3, SHADOW_ALMOST_LINEAR, abs(c3) < SHADOW_ALMOST_LINEAR);
    float root = sqrt(max(c2 * c2 - 4.0 * c1 * leading, 0.0));
    float q = -0.5 * (c2 + shadow_select(root, -root, c2 < 0.0));
    float one = q / leading;
    float other = 0.0;
    if (q != 0.0) {
        other = c1 / q;
    }
    float low = min(one, other);
    float high = max(max(one, other), low + SHADOW_ROUNDING);
    if (z < low) {
        return 0.0;
    }
    if (z > high) {
        return 1.0 - at_z;
    }
    return (high * (1.0 - at_z) - b.x + z * at_z) / (high - low);
}

float shadow_bound(vec4 moments, float receiver) {
    // Against rounding: towards the moments of a broad distribution.
    vec4 biased = moments + SHADOW_MOMENT_BIAS * (vec4(0.0, 0.375, 0.0, 0.375) - moments);
    return clamp(1.0 - shadow_least(biased, 2.0 * receiver - 1.0), 0.0, 1.0);
}
