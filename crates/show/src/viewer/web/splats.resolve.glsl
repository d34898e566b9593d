// Layers of what was blended. Follows layers.glsl.
uniform vec2 focal;           // pixels of the camera's image
uniform vec2 principal;       // pixels of the camera's image
uniform vec3 placing;         // canvas pixel = xy + z * image pixel, y downwards
uniform float canvasHeight;
uniform vec2 codes;           // ends of the range of log10 U
uniform sampler2D light;      // colour without background, opacity
uniform sampler2D knowledge;  // log10 U in parts of its range, depth along the view axis, never seen; times opacity

out vec4 picture;

void main() {
    vec4 seen = texelFetch(light, ivec2(gl_FragCoord.xy), 0);
    vec3 known = texelFetch(knowledge, ivec2(gl_FragCoord.xy), 0).xyz / max(seen.a, 1e-6);
    vec2 at = vec2(gl_FragCoord.x, canvasHeight - gl_FragCoord.y);
    vec2 tangent = ((at - placing.xy) / placing.z - principal) / focal;
    float depth = known.y * length(vec3(tangent, 1.0));
    picture = vec4(layered(at, seen.rgb, seen.a, depth, mix(codes.x, codes.y, known.x), known.z > 0.5), 1.0);
}
