// Visibility of the light at a point of a surface: 1 lit, 0 shadowed.
//
// map: the shadow map's window depths, 1 where it is empty
// world_to_eye, eye_to_clip: the light's matrices, with which the map was drawn
// position: of the surface in world units; normal: of its plane, of length 1, not interpolated
// to_light: unit vector from there to the light
// pixel: counted from the picture's lower left pixel, which is (0, 0); only patterns use it
// layer: of the map; 0 if it has only one
float shadow(SHADOW_MAPS, mat4 world_to_eye, mat4 eye_to_clip, vec3 position, vec3 normal, vec3 to_light, vec2 pixel, int layer) {
    ShadowView view = shadow_view(map, world_to_eye, eye_to_clip, layer);
    return shadow_in_view(shadow_maps, view, position, normal, to_light, pixel);
}
