// The layer of a point light's map that sees a point: faces along +x, -x, +y, -y, +z and -z, in this order.
int shadow_layer(vec3 from_light) {
    vec3 size = abs(from_light);
    if (size.x >= size.y && size.x >= size.z) {
        return shadow_select(0, 1, from_light.x < 0.0);
    }
    if (size.y >= size.z) {
        return shadow_select(2, 3, from_light.y < 0.0);
    }
    return shadow_select(4, 5, from_light.z < 0.0);
}
