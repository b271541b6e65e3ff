// Interleaved gradient noise (Jimenez 2014), in [0, 1).
float shadow_noise(vec2 pixel) {
    return fract(52.9829189 * fract(0.06711056 * pixel.x + 0.00583715 * pixel.y));
}

// Which pixel of a pattern's tile, whose sides have `size` pixels, a pixel of the picture is.
int shadow_tile_pixel(vec2 pixel, int size) {
    ivec2 at = ivec2(pixel);
    return at.y % size * size + at.x % size;
}

// Turns a point by an angle in radians.
vec2 shadow_turned(vec2 at, float angle) {
    return vec2(cos(angle) * at.x - sin(angle) * at.y, sin(angle) * at.x + cos(angle) * at.y);
}
