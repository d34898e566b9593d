// A splat's ellipse on the canvas, as crates/splats/src/render/project.rs explains.
precision highp float;
precision highp int;
precision highp usampler2D;

// Lengths and positions are in scene units, from the anchor of the stored positions.
uniform sampler2D splats;     // four texels each: mean, opacity; covariance, log10 U in parts of its range, never seen;
                              // colour
uniform usampler2D order;     // which splat is drawn when, from the farthest
uniform vec3 eye;
uniform mat3 toScene;         // right, down and forward in scene axes
uniform vec2 focal;           // pixels of the camera's image
uniform vec2 principal;       // pixels of the camera's image
uniform vec3 placing;         // canvas pixel = xy + z * image pixel, y downwards
uniform vec4 limits;          // least and largest x/z and y/z of a splat's shape
uniform vec2 canvas;          // pixels
uniform bool isMip;
uniform float dilation;       // variance by which every splat grows, square pixels of the camera's image
uniform float faintest;       // least opacity that is drawn
uniform float unit;           // of depth, scene units

flat out vec2 center;         // pixels of the camera's image
flat out vec3 conic;
flat out vec4 light;          // colour and opacity
flat out vec3 known;          // log10 U in parts of its range, depth along the view axis, never seen

void main() {
    int rank = gl_VertexID >> 2;
    uint splat = texelFetch(order, ivec2(rank & 511, rank >> 9), 0).r;
    ivec2 first = ivec2(4 * int(splat & 511u), int(splat >> 9));
    vec4 place = texelFetch(splats, first, 0);
    vec4 upper = texelFetch(splats, first + ivec2(1, 0), 0);
    vec4 lower = texelFetch(splats, first + ivec2(2, 0), 0);
    vec3 color = texelFetch(splats, first + ivec2(3, 0), 0).rgb;
    vec3 t = (place.xyz - eye) * toScene;
    vec2 tangent = clamp(t.xy / t.z, limits.xy, limits.zw);
    // Rows of the Jacobian in scene axes.
    vec3 u = focal.x / t.z * (toScene[0] - tangent.x * toScene[2]);
    vec3 v = focal.y / t.z * (toScene[1] - tangent.y * toScene[2]);
    mat3 covariance = mat3(upper.xyz, vec3(upper.y, upper.w, lower.x), vec3(upper.z, lower.xy));
    vec3 wide = covariance * u, high = covariance * v;
    vec3 raw = vec3(dot(u, wide), dot(u, high), dot(v, high));
    vec3 grown = raw + vec3(dilation, 0.0, dilation);
    float determinant = grown.x * grown.z - grown.y * grown.y;
    float opacity = place.w;
    if (isMip) opacity *= sqrt(max(raw.x * raw.z - raw.y * raw.y, 0.0) / determinant);
    float reach = 2.0 * log(opacity / faintest);
    if (!(reach >= 0.0 && determinant > 0.0)) {
        gl_Position = vec4(2.0, 2.0, 2.0, 1.0);
        return;
    }
    center = focal * t.xy / t.z + principal;
    conic = vec3(grown.z, -grown.y, grown.x) / determinant;
    light = vec4(color, opacity);
    known = vec3(lower.z, t.z / unit, lower.w);
    // The rectangle along the axes of the ellipse: a thin splat covers few pixels in vain.
    float middle = 0.5 * (grown.x + grown.z), apart = length(vec2(0.5 * (grown.x - grown.z), grown.y));
    vec2 slope = vec2(grown.y, middle + apart - grown.x);
    vec2 along = abs(grown.y) > 1e-6 * middle ? normalize(slope) : vec2(grown.x >= grown.z, grown.x < grown.z);
    vec2 lengths = sqrt(reach * vec2(middle + apart, max(middle - apart, dilation)));
    vec2 corner = lengths * (vec2(gl_VertexID & 1, (gl_VertexID >> 1) & 1) * 2.0 - 1.0);
    vec2 at = placing.xy + placing.z * (center + corner.x * along + corner.y * vec2(-along.y, along.x));
    gl_Position = vec4(2.0 * at.x / canvas.x - 1.0, 1.0 - 2.0 * at.y / canvas.y, 0.0, 1.0);
}
