// One ray per pixel through the volume. Compiled twice: for the picture, and with NUMBERS for what it stands for.
precision highp sampler3D;
precision highp usampler3D;

// Lengths and positions are in units of the volume, from the middle of the model's box or of the contraction: f32 then
// resolves scenes that are far from their origin.
uniform vec3 eye;
uniform mat3 axes;            // camera to world: right, up, back
uniform vec2 focal;           // pixels of the camera's image
uniform vec2 principal;       // pixels of the camera's image
uniform vec3 placing;         // canvas pixel = xy + z * image pixel, y downwards
uniform float canvasHeight;
uniform vec3 low, high;       // the model's box, cropped
uniform vec3 origin;          // of the lattice
uniform float edge;           // of a cell
uniform ivec3 bricks;
uniform vec3 atlasSize;       // texels
uniform int norm;             // 0: no contraction, 1: Euclidean, 2: largest coordinate
uniform float threshold;      // share of the prior above which matter is removed
uniform float unseenFrom;     // share of the prior from which on no ray came
uniform bool hidesUnseen;     // whether matter where no ray came is removed
uniform vec2 codes;           // log10 U of code 1 and of the prior, which is code 254
uniform usampler3D pages;
uniform sampler3D matter;     // red, green, blue, sqrt(absorbed along a cell)
uniform sampler3D knowledge;  // code of log10 U as seen; share of the prior at the point, in PARTS, more if no ray came

#ifdef NUMBERS
const bool NUMBERED = true;
layout(location = 0) out uvec4 numbers;
#else
const bool NUMBERED = false;
layout(location = 0) out vec4 picture;
#endif

const float CELLS = 7.0;
const float PARTS = 32768.0;
const float STEP = 0.5;            // of a cell
const float END = 0.003;           // transmittance at which a ray ends

float reach(vec3 p) {
    vec3 a = abs(p);
    return norm == 1 ? length(p) : max(a.x, max(a.y, a.z));
}

// Lattice coordinates of a point.
vec3 lattice(vec3 p) {
    if (norm != 0) {
        float r = reach(p);
        if (r > 1.0) p *= (2.0 - 1.0 / r) / r;
    }
    return (p - origin) / edge;
}

// How much longer than in the middle a cell's edge is around a point.
float stretch(vec3 p) {
    if (norm == 0) return 1.0;
    float r = reach(p);
    return r > 1.0 ? r / (2.0 - 1.0 / r) : 1.0;
}

// Lattice cells that a ray crosses per unit of length.
float speed(vec3 p, vec3 d) {
    if (norm == 0) return 1.0 / edge;
    float r = reach(p);
    if (r <= 1.0) return 1.0 / edge;
    float k = (2.0 - 1.0 / r) / r;
    float slope = (2.0 / r - 2.0) / (r * r);
    vec3 a = abs(p);
    vec3 outwards = norm == 1 ? p / r : sign(p) * vec3(a.x == r, a.x != r && a.y == r, a.x != r && a.y != r);
    return max(length(k * d + slope * dot(outwards, d) * p) / edge, 1e-6);
}

// Where a ray enters and leaves the model's box.
vec2 crossing(vec3 d) {
    vec3 a = (low - eye) / d, b = (high - eye) / d;
    vec3 near = min(a, b), far = max(a, b);
    return vec2(max(max(near.x, near.y), max(near.z, 0.0)), min(far.x, min(far.y, far.z)));
}

void main() {
    vec2 at = vec2(gl_FragCoord.x, canvasHeight - gl_FragCoord.y);
    vec2 image = (at - placing.xy) / placing.z;
    vec2 seen = (image - principal) / focal;
    vec3 d = axes * normalize(vec3(seen.x, -seen.y, -1.0));
    // A direction along an axis would divide by zero.
    d = mix(d, vec3(1e-7), vec3(lessThan(abs(d), vec3(1e-7))));

    float transmittance = 1.0, sum = 0.0, depth = 0.0, unseen = 0.0;
    vec3 color = vec3(0.0);
    int reads = 0;
    vec2 ends = crossing(d);
    float t = ends.x;
    ivec3 last = ivec3(-1);
    uvec4 page = uvec4(0u);
    bool isLong = false;
    float most = 1.0005 * PARTS * threshold;
    bool asksU = layerAt(at.x) > 1 || threshold < 1.0 || hidesUnseen || NUMBERED;
    for (int i = 0; i < 4096 && t < ends.y && transmittance > END; i++) {
        vec3 p = eye + t * d;
        vec3 g = lattice(p);
        ivec3 brick = clamp(ivec3(floor(g / CELLS)), ivec3(0), bricks - 1);
        if (brick != last) {
            page = texelFetch(pages, brick, 0);
            last = brick;
            reads++;
        }
        float cells = speed(p, d);
        if (page.a > 0u) {
            // Nothing in all bricks nearer than page.a.
            vec3 from = CELLS * vec3(brick - ivec3(page.a) + 1), to = CELLS * vec3(brick + ivec3(page.a));
            if (norm == 0) {
                vec3 walk = d / edge;
                vec3 leaves = (mix(from, to, step(vec3(0.0), walk)) - g) / walk;
                t += max(min(leaves.x, min(leaves.y, leaves.z)), 0.0) + 0.01 * edge;
                isLong = false;
            } else {
                // Rays are curved there, and faster towards the middle.
                vec3 room = min(g - from, to - g);
                float straight = 0.5 * max(min(room.x, min(room.y, room.z)), 0.0) / cells;
                t += max(min(straight, 0.3 * reach(p) + 0.3), STEP / cells);
            }
            continue;
        }
        float advance = min(STEP / cells, ends.y - t + 1e-6);
        vec3 texel = (8.0 * vec3(page.xyz) + clamp(g - CELLS * vec3(brick), 0.0, CELLS) + 0.5) / atlasSize;
        vec4 found = texture(matter, texel);
        reads++;
        if (found.a <= 0.002) {
            // Matter is at least two cells wide, as it is interpolated: half of that can be passed over.
            t += 2.0 * advance;
            isLong = true;
            continue;
        }
        if (isLong) {
            // It may have begun on the way.
            t -= advance;
            isLong = false;
            continue;
        }
        vec2 known = vec2(0.0);
        if (asksU) {
            known = texture(knowledge, texel).rg;
            reads++;
        }
        // What is removed is what is uncertain where it is; what is shown is what a ray as a whole says.
        bool isUnseen = known.g >= unseenFrom * PARTS;
        if (isUnseen ? !hidesUnseen : min(known.g, PARTS) <= most) {
            float passed = pow(max(1.0 - found.a * found.a, 0.001), advance / (edge * stretch(p)));
            float weight = transmittance * (1.0 - passed);
            if (transmittance > 0.5 && transmittance - weight <= 0.5) {
                depth = t + advance * (log(2.0 * transmittance) / -log(passed) - 0.5);
                unseen = step(1.25 * PARTS, known.g);
            }
            transmittance -= weight;
            color += weight * found.rgb;
            sum += weight * mix(codes.x, codes.y, (known.r - 1.0) / 253.0);
        }
        t += advance;
    }
    float opacity = 1.0 - transmittance;
    float log10U = opacity > 0.0 ? sum / opacity : 0.0;
#ifdef NUMBERS
    numbers = floatBitsToUint(vec4(opacity, opacity > 0.5 ? depth : 0.0, log10U, float(reads)));
#else
    picture = vec4(layered(at, color, opacity, depth, log10U, unseen > 0.5), 1.0);
#endif
}
