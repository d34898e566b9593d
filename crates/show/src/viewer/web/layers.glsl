// What a layer shows of a pixel, whatever the kind of the model.
precision highp float;
precision highp int;

uniform vec3 background;
uniform vec2 range;           // ends of the colour bar of log10 U
uniform vec2 depths;          // ends of the colour bar of depth
uniform int layer;            // 0 colour, 1 depth, 2 log10 U, 3 colour tinted by U
uniform float split;          // canvas x: to the left of it colour is shown
uniform sampler2D maps;       // row 0: log10 U, row 1: depth

const float FAINT = 0.05;     // opacity below which no log10 U is shown
const vec3 NOTHING = vec3(225.0) / 255.0;
const vec3 HATCHING = vec3(150.0) / 255.0;

int layerAt(float x) {
    return x < split ? 0 : layer;
}

// The canvas pixel `at`, whose colour is without background, and in which log10 U is a mean over what is hit.
vec3 layered(vec2 at, vec3 color, float opacity, float depth, float log10U, bool isUnseen) {
    int shownLayer = layerAt(at.x);
    isUnseen = isUnseen && opacity > 0.5;
    // What was never seen has the colour of it, whatever shines through.
    float place = isUnseen ? 1.0 : clamp((log10U - range.x) / (range.y - range.x), 0.0, 1.0);
    vec3 ofU = texture(maps, vec2((255.0 * place + 0.5) / 256.0, 0.25)).rgb;
    if (shownLayer == 1) {
        float far = clamp((depth - depths.x) / (depths.y - depths.x), 0.0, 1.0);
        return opacity > 0.5 ? texture(maps, vec2((255.0 * far + 0.5) / 256.0, 0.75)).rgb : NOTHING;
    }
    if (shownLayer == 2) {
        bool isStripe = mod(floor(at.x) + floor(at.y), 6.0) < 2.0;
        if (isUnseen && isStripe) return HATCHING;
        return opacity > FAINT ? ofU : NOTHING;
    }
    if (shownLayer == 3) {
        float grey = dot(color, vec3(0.3, 0.59, 0.11)) / max(opacity, 1e-3);
        // The dark end of the colour map would hide what is certain: there the colour itself is shown.
        float tint = 0.8 * smoothstep(0.1, 0.6, place);
        vec3 tinted = mix(color / max(opacity, 1e-3), ofU * (0.35 + 0.65 * grey), tint);
        return mix(background, tinted, opacity);
    }
    return color + (1.0 - opacity) * background;
}
