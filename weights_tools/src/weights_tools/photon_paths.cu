// Backward Monte Carlo of many small cloud scenes: the radiance (1/sr, for a solar irradiance of 1)
// of every pixel of every view.
//
// A scene is a box of voxels of constant extinction in open surroundings, below an exponential
// molecular atmosphere, above a Lambertian surface at altitude 0. A path starts at the camera; at
// each scattering, the direct sunlight is added (local estimate), and the next direction is drawn
// from the phase function, whose forward peak is truncated (droplets.py). The random numbers of a
// path depend on the seed of its scene, the pixel and the number of the path only.
//
// The file compiles for a GPU, by nvcc or NVRTC, with one warp for each pixel, and by a C++
// compiler for the CPU (renderers.py). Lengths are in km.

#ifdef __CUDACC__
#define INLINE __device__ __forceinline__
#else
#include <cmath>
#define INLINE static inline
#endif

typedef unsigned int Bits;
typedef unsigned long long LongBits;

constexpr float FAR = 1e30f;
constexpr float PI = 3.14159265f;
constexpr float TOP = 60.0f;        // altitude at which paths start
constexpr float OPAQUE = 25.0f;     // optical depth beyond which no light is transmitted
constexpr float CLOUDY = 3e-3f;     // optical depth of a line of sight that meets a cloud
constexpr int LONGEST = 2000;       // scatterings of a path
constexpr int ROULETTE = 60;        // scatterings after which a path may end at random
constexpr float SURVIVAL = 0.98f;

struct Vector { float x, y, z; };

INLINE Vector operator+(Vector a, Vector b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }
INLINE Vector operator*(float s, Vector a) { return {s * a.x, s * a.y, s * a.z}; }
INLINE float dot(Vector a, Vector b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
INLINE Vector cross(Vector a, Vector b) {
    return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}
INLINE Vector normalized(Vector a) { return (1.0f / sqrtf(dot(a, a))) * a; }

// All members have four bytes; renderers.py contains the same declarations.
struct Scene {
    float voxel, level, bottom;     // horizontal and vertical voxel size, altitude of the grid
    Vector sun;                     // towards the Sun
    float albedo;                   // of the surface
    float air, air_height;          // extinction of the air at altitude 0 (1/km), scale height
    int low[3], high[3];            // cloudy voxels along x, y, z: low <= index < high
    Bits seed;
};
struct View {
    Vector towards;                 // from the target, the centre of the grid, to the camera
    float distance, pixel;          // of the camera; size of a pixel at the target
};
struct Sizes {
    int scenes, views, rows, cols;
    int levels, voxels;             // voxels along z, and along x and along y
    int few, many;                  // paths of a pixel, and of one whose first paths meet a cloud
    int angles, cumulative;         // lengths of the rows of the tables
};
struct Arrays {
    const Scene *scenes;
    const View *views;              // [scene, view]
    const float *extinction;        // without the forward peak (1/km), [scene, z, y, x]
    const float *droplets;          // continuous index in the tables, [scene, z, y, x]
    const float *phase, *cosine;    // [droplets, angles], [droplets, cumulative]
    float *radiance;                // [scene, view, row, col]
};

// Permuted congruential generator (O'Neill 2014), with a stream for each pixel.
struct Random { LongBits state, stream; };

INLINE Bits next(Random &random) {
    LongBits old = random.state;
    random.state = old * 6364136223846793005ULL + random.stream;
    Bits word = (Bits)(((old >> 18) ^ old) >> 27), turn = (Bits)(old >> 59);
    return (word >> turn) | (word << ((32 - turn) & 31));
}
// In (0, 1).
INLINE float uniform(Random &random) {
    return ((float)(next(random) >> 8) + 0.5f) * (1.0f / 16777216.0f);
}
INLINE LongBits scrambled(LongBits value) {
    value = (value ^ (value >> 30)) * 0xBF58476D1CE4E5B9ULL;
    value = (value ^ (value >> 27)) * 0x94D049BB133111EBULL;
    return value ^ (value >> 31);
}
INLINE Random random_of(Bits seed, Bits pixel, Bits path) {
    Random random;
    random.stream = (scrambled(((LongBits)seed << 32) + pixel) << 1) | 1;
    random.state = scrambled(random.stream + 0x9E3779B97F4A7C15ULL * (path + 1));
    next(random);
    return random;
}

// The voxels along a ray, within the box that contains the cloud.
struct Walk {
    float at, end;                  // distances: current position, end of the box
    float crossing[3], apart[3];    // distance of the next boundary along each axis, between two
    int left[3], stride[3];         // voxels until the end of the box, step of the index
    int voxel;
};

INLINE bool begin(Walk &walk, const Scene &scene, const Sizes &sizes, Vector p, Vector d,
                  float end) {
    float per[3] = {1.0f / scene.voxel, 1.0f / scene.voxel, 1.0f / scene.level};
    float middle = 0.5f * sizes.voxels;
    float from[3] = {p.x * per[0] + middle, p.y * per[1] + middle, (p.z - scene.bottom) * per[2]};
    float speed[3] = {d.x * per[0], d.y * per[1], d.z * per[2]};
    int strides[3] = {1, sizes.voxels, sizes.voxels * sizes.voxels};
    walk.at = 0.0f;
    walk.end = end;
    for (int a = 0; a < 3; a++) {
        if (fabsf(speed[a]) < 1e-6f) speed[a] = 1e-6f;
        walk.apart[a] = 1.0f / speed[a];
        float one = (scene.low[a] - from[a]) * walk.apart[a];
        float other = (scene.high[a] - from[a]) * walk.apart[a];
        walk.at = fmaxf(walk.at, fminf(one, other));
        walk.end = fminf(walk.end, fmaxf(one, other));
    }
    if (walk.at >= walk.end) return false;
    walk.voxel = 0;
    for (int a = 0; a < 3; a++) {
        int index = (int)floorf(from[a] + speed[a] * walk.at);
        index = index < scene.low[a] ? scene.low[a] : index;
        index = index >= scene.high[a] ? scene.high[a] - 1 : index;
        bool forward = speed[a] > 0.0f;
        walk.crossing[a] = (index + (forward ? 1 : 0) - from[a]) * walk.apart[a];
        walk.apart[a] = fabsf(walk.apart[a]);
        walk.left[a] = forward ? scene.high[a] - 1 - index : index - scene.low[a];
        walk.stride[a] = forward ? strides[a] : -strides[a];
        walk.voxel += index * strides[a];
    }
    return true;
}

INLINE float part_in_voxel(const Walk &walk) {
    float next = fminf(fminf(walk.crossing[0], walk.crossing[1]), walk.crossing[2]);
    return fmaxf(fminf(next, walk.end) - walk.at, 0.0f);
}

// Proceed to the next voxel; false at the end of the ray or of the box.
INLINE bool proceed(Walk &walk) {
    int a = walk.crossing[0] <= walk.crossing[1] ? 0 : 1;
    if (walk.crossing[2] < walk.crossing[a]) a = 2;
    // Written out for each axis, as stores to an unknown index would need local memory. (With the
    // comparison written out as well, NVRTC 12.9 needs 158 registers instead of 79 for sm_90.)
#define ALONG(axis)                                                        \
    if (a == axis) {                                                       \
        walk.at = fmaxf(walk.at, walk.crossing[axis]);                     \
        walk.crossing[axis] += walk.apart[axis];                           \
        walk.voxel += walk.stride[axis];                                   \
        return walk.at < walk.end && walk.left[axis]-- > 0;                \
    }
    ALONG(0)
    ALONG(1)
    ALONG(2)
#undef ALONG
    return false;
}

// Optical depth of the cloud along a ray.
INLINE float cloud_depth(const Scene &scene, const Sizes &sizes, const float *extinction, Vector p,
                         Vector d) {
    Walk walk;
    float depth = 0.0f;
    if (!begin(walk, scene, sizes, p, d, FAR)) return depth;
    do depth += extinction[walk.voxel] * part_in_voxel(walk);
    while (depth < OPAQUE && proceed(walk));
    return depth;
}

// Distance at which the optical depth of the cloud reaches `depth`, and the voxel; FAR if it does
// not before `end`.
INLINE float collision(const Scene &scene, const Sizes &sizes, const float *extinction, Vector p,
                       Vector d, float end, float depth, int &voxel) {
    Walk walk;
    if (!begin(walk, scene, sizes, p, d, end)) return FAR;
    do {
        float here = extinction[walk.voxel], part = here * part_in_voxel(walk);
        if (part >= depth && here > 0.0f) {
            voxel = walk.voxel;
            return walk.at + depth / here;
        }
        depth -= part;
    } while (proceed(walk));
    return FAR;
}

// Distance at which the optical depth of the air reaches `depth`, from the altitude z.
INLINE float air_collision(const Scene &scene, float z, float upwards, float depth) {
    float height = scene.air_height, density = expf(-z / height);
    if (fabsf(upwards) < 1e-5f) return depth / (scene.air * density);
    float rest = density - depth * upwards / (scene.air * height);
    return rest > 0.0f ? (-height * logf(rest) - z) / upwards : FAR;
}

// Transmittance of cloud and air between a point and the Sun.
INLINE float sunlight(const Scene &scene, const Sizes &sizes, const float *extinction, Vector p) {
    float depth = cloud_depth(scene, sizes, extinction, p, scene.sun);
    depth += scene.air * scene.air_height * expf(-p.z / scene.air_height) / scene.sun.z;
    return expf(-depth);
}

// A direction at a given angle from `axis`.
INLINE Vector deflected(Vector axis, float cosine, Random &random) {
    float sine = sqrtf(fmaxf(0.0f, 1.0f - cosine * cosine)), turn = 2.0f * PI * uniform(random);
    Vector other = fabsf(axis.z) < 0.9f ? Vector{0.0f, 0.0f, 1.0f} : Vector{1.0f, 0.0f, 0.0f};
    Vector u = normalized(cross(other, axis)), v = cross(axis, u);
    return normalized((sine * cosf(turn)) * u + (sine * sinf(turn)) * v + cosine * axis);
}

// The value of a row of a table at a continuous index.
INLINE float interpolated(const float *row, int length, float index) {
    index = fminf(fmaxf(index, 0.0f), length - 1.001f);
    int whole = (int)index;
    float share = index - whole;
    return row[whole] * (1.0f - share) + row[whole + 1] * share;
}

// Optical depth of the air along a ray from the altitude z.
INLINE float air_depth(const Scene &scene, float z, float upwards, float distance) {
    float height = scene.air_height, density = expf(-z / height);
    if (fabsf(upwards) < 1e-5f) return scene.air * density * distance;
    return scene.air * height * (density - expf(-(z + upwards * distance) / height)) / upwards;
}

enum Kind { DROPLET, GROUND, AIR };

// A scattering: its kind and, for a droplet, the row of the tables.
struct Event {
    Kind kind;
    int row;
};

// The sunlight that is scattered once at p into the direction of the camera; `cosine` is that of
// the angle between the line of sight and the direction towards the Sun.
INLINE float direct(const Scene &scene, const Sizes &sizes, const Arrays &arrays,
                    const float *extinction, Event event, Vector p, float cosine) {
    float phase = 3.0f / (16.0f * PI) * (1.0f + cosine * cosine);
    if (event.kind == GROUND) phase = scene.albedo / PI * scene.sun.z;
    if (event.kind == DROPLET) {
        float angle = acosf(cosine) * ((sizes.angles - 1) / PI);
        phase = interpolated(arrays.phase + event.row * sizes.angles, sizes.angles, angle);
    }
    return phase * sunlight(scene, sizes, extinction, p);
}

// The direction after a scattering; the path ends if it is zero.
INLINE Vector scattered(const Scene &scene, const Sizes &sizes, const Arrays &arrays, Event event,
                        Vector d, Random &random) {
    if (event.kind == GROUND) {
        if (uniform(random) >= scene.albedo) return {0.0f, 0.0f, 0.0f};
        return deflected({0.0f, 0.0f, 1.0f}, sqrtf(uniform(random)), random);
    }
    float cosine;
    if (event.kind == DROPLET) {
        float index = uniform(random) * sizes.cumulative - 0.5f;
        const float *table = arrays.cosine + event.row * sizes.cumulative;
        cosine = interpolated(table, sizes.cumulative, index);
    } else {
        do cosine = 2.0f * uniform(random) - 1.0f;
        while (2.0f * uniform(random) > 1.0f + cosine * cosine);
    }
    return deflected(d, cosine, random);
}

// The radiance along one path from p in direction d.
INLINE float followed(const Scene &scene, const Sizes &sizes, const Arrays &arrays,
                      const float *extinction, const float *droplets, Vector p, Vector d,
                      Random &random) {
    float radiance = 0.0f, weight = 1.0f;
    for (int order = 0; order < LONGEST; order++) {
        float ground = d.z < 0.0f ? (1e-5f - p.z) / d.z : FAR;
        int voxel = 0;
        float depth = -logf(uniform(random));
        float distance = collision(scene, sizes, extinction, p, d, ground, depth, voxel);
        // One of the two adjacent radii of the table, in proportion to their distance.
        Event event = {GROUND, 0};
        if (distance < ground) event = {DROPLET, (int)(droplets[voxel] + uniform(random))};
        distance = fminf(distance, ground);
        float cosine = fminf(1.0f, fmaxf(-1.0f, dot(d, scene.sun)));
        Event air = {AIR, 0};
        if (order == 0) {
            // The light from the air and that from behind it are added for every line of sight, as
            // the few scatterings in the thin air would otherwise make the images noisy.
            float share = expf(-air_depth(scene, p.z, d.z, distance));
            float drawn = -logf(1.0f - uniform(random) * (1.0f - share));
            float nearer = fminf(air_collision(scene, p.z, d.z, drawn), distance);
            Vector in_air = p + nearer * d, behind = p + distance * d;
            radiance += (1.0f - share)
                        * direct(scene, sizes, arrays, extinction, air, in_air, cosine);
            radiance += share * direct(scene, sizes, arrays, extinction, event, behind, cosine);
            bool continues_in_air = uniform(random) >= share;
            if (continues_in_air) event = air;
            p = continues_in_air ? in_air : behind;
        } else {
            float nearer = air_collision(scene, p.z, d.z, -logf(uniform(random)));
            if (nearer < distance) {
                distance = nearer;
                event = air;
            }
            if (distance > 1e6f) break;
            p = p + distance * d;
            radiance += weight * direct(scene, sizes, arrays, extinction, event, p, cosine);
        }
        d = scattered(scene, sizes, arrays, event, d, random);
        if (dot(d, d) < 0.5f) break;
        if (order >= ROULETTE) {
            if (uniform(random) > SURVIVAL) break;
            weight /= SURVIVAL;
        }
    }
    return radiance;
}

// A pixel of a view, whose paths share the pointers.
struct Pixel {
    const Scene *scene;
    const View *view;
    const float *extinction, *droplets;
    int row, col;
    Bits number;                    // among all pixels of the scene
};

INLINE Pixel pixel_of(const Sizes &sizes, const Arrays &arrays, LongBits index) {
    Bits pixels = sizes.rows * sizes.cols;
    Bits by_scene = pixels * sizes.views;
    Bits scene = (Bits)(index / by_scene), number = (Bits)(index % by_scene);
    LongBits voxels = (LongBits)scene * sizes.levels * sizes.voxels * sizes.voxels;
    Pixel pixel;
    pixel.scene = arrays.scenes + scene;
    pixel.view = arrays.views + (LongBits)scene * sizes.views + number / pixels;
    pixel.extinction = arrays.extinction + voxels;
    pixel.droplets = arrays.droplets + voxels;
    pixel.row = number % pixels / sizes.cols;
    pixel.col = number % sizes.cols;
    pixel.number = number;
    return pixel;
}

// One path of a pixel; `cloudy` becomes true if its line of sight meets the cloud.
INLINE float sample(const Sizes &sizes, const Arrays &arrays, const Pixel &pixel, Bits path,
                    bool &cloudy) {
    const Scene &scene = *pixel.scene;
    const View &view = *pixel.view;
    Random random = random_of(scene.seed, pixel.number, path);
    Vector east = {1.0f, 0.0f, 0.0f};
    Vector column = normalized(east + (-view.towards.x) * view.towards);
    Vector row = cross(view.towards, column);
    float right = (pixel.col + uniform(random) - 0.5f * sizes.cols) * view.pixel;
    float up = (pixel.row + uniform(random) - 0.5f * sizes.rows) * view.pixel;
    Vector aside = right * column + up * row;
    Vector d = normalized(aside + (-view.distance) * view.towards);
    Vector p = aside + Vector{0.0f, 0.0f, scene.bottom + 0.5f * sizes.levels * scene.level};
    // Beyond its upper end, the air has no effect.
    p = p + ((TOP - p.z) / d.z) * d;
    if (!cloudy) cloudy = cloud_depth(scene, sizes, pixel.extinction, p, d) > CLOUDY;
    return followed(scene, sizes, arrays, pixel.extinction, pixel.droplets, p, d, random);
}

#ifdef __CUDACC__

extern "C" __global__ void __launch_bounds__(256) render(Sizes sizes, Arrays arrays) {
    LongBits index = ((LongBits)blockIdx.x * blockDim.x + threadIdx.x) / 32;
    int lane = threadIdx.x % 32;
    if (index >= (LongBits)sizes.scenes * sizes.views * sizes.rows * sizes.cols) return;
    Pixel pixel = pixel_of(sizes, arrays, index);
    float sum = 0.0f;
    bool cloudy = false;
    int paths = sizes.few;
    for (int path = lane; path < sizes.few; path += 32)
        sum += sample(sizes, arrays, pixel, path, cloudy);
    if (__any_sync(0xffffffff, cloudy)) {
        paths = sizes.many;
        for (int path = sizes.few + lane; path < sizes.many; path += 32)
            sum += sample(sizes, arrays, pixel, path, cloudy);
    }
    for (int half = 16; half > 0; half /= 2) sum += __shfl_down_sync(0xffffffff, sum, half);
    if (lane == 0) arrays.radiance[index] = sum / paths;
}

#else

extern "C" void render(const Sizes *sizes, const Arrays *arrays) {
    LongBits pixels = (LongBits)sizes->scenes * sizes->views * sizes->rows * sizes->cols;
    for (LongBits index = 0; index < pixels; index++) {
        Pixel pixel = pixel_of(*sizes, *arrays, index);
        double sum = 0.0;
        bool cloudy = false;
        int paths = 0;
        for (; paths < sizes->few; paths++) sum += sample(*sizes, *arrays, pixel, paths, cloudy);
        for (; cloudy && paths < sizes->many; paths++)
            sum += sample(*sizes, *arrays, pixel, paths, cloudy);
        arrays->radiance[index] = (float)(sum / paths);
    }
}

#endif
