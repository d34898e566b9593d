// A splat's share of a pixel, to be blended over what lies behind it.
precision highp float;

uniform vec3 placing;         // canvas pixel = xy + z * image pixel, y downwards
uniform float canvasHeight;
uniform float faintest;       // least and largest opacity that is drawn
uniform float mostOpaque;

flat in vec2 center;
flat in vec3 conic;
flat in vec4 light;
flat in vec3 known;

layout(location = 0) out vec4 shown;
layout(location = 1) out vec4 knowledge;

void main() {
    vec2 d = center - (vec2(gl_FragCoord.x, canvasHeight - gl_FragCoord.y) - placing.xy) / placing.z;
    float q = conic.x * d.x * d.x + 2.0 * conic.y * d.x * d.y + conic.z * d.y * d.y;
    float alpha = min(light.a * exp(-0.5 * q), mostOpaque);
    if (alpha < faintest) discard;
    shown = alpha * vec4(light.rgb, 1.0);
    knowledge = alpha * vec4(known, 1.0);
}
