// Neighbour search, farthest points and signed distances for training on a GPU.
extern "C" __global__ void knn(const float* q, const float* p, long long* out,
                               int queries, int points, int batch) {
    long long t = (long long)blockIdx.x * blockDim.x + threadIdx.x;
    if (t >= (long long)queries * batch) return;
    const float* cloud = p + (t / queries) * points * DIM;
    float x[DIM];
    float best[COUNT];
    int index[COUNT];
    #pragma unroll
    for (int d = 0; d < DIM; ++d) x[d] = q[t * DIM + d];
    #pragma unroll
    for (int k = 0; k < COUNT; ++k) { best[k] = 3.0e38f; index[k] = 0; }
    for (int i = 0; i < points; ++i) {
        float far = 0.0f;
        #pragma unroll
        for (int d = 0; d < DIM; ++d) { float gap = x[d] - cloud[i * DIM + d]; far += gap * gap; }
        if (far < best[COUNT - 1]) {
            #pragma unroll
            for (int k = COUNT - 1; k > 0; --k) {
                if (far < best[k - 1]) { best[k] = best[k - 1]; index[k] = index[k - 1]; }
                else if (far < best[k]) { best[k] = far; index[k] = i; }
            }
            if (far < best[0]) { best[0] = far; index[0] = i; }
        }
    }
    #pragma unroll
    for (int k = 0; k < COUNT; ++k) out[t * COUNT + k] = index[k];
}

extern "C" __global__ void sdf(const float* x, const float* tri, float* out, int count, int faces) {
    int t = blockIdx.x * blockDim.x + threadIdx.x;
    if (t >= count) return;
    float px = x[3 * t], py = x[3 * t + 1], pz = x[3 * t + 2];
    float nearest = 3.0e38f, turn = 0.0f;
    for (int f = 0; f < faces; ++f) {
        const float* c = tri + 9 * f;
        float ax = c[0] - px, ay = c[1] - py, az = c[2] - pz;
        float bx = c[3] - px, by = c[4] - py, bz = c[5] - pz;
        float ux = c[6] - px, uy = c[7] - py, uz = c[8] - pz;
        float ex = bx - ax, ey = by - ay, ez = bz - az;          // a to b
        float gx = ux - bx, gy = uy - by, gz = uz - bz;          // b to c
        float hx = ax - ux, hy = ay - uy, hz = az - uz;          // c to a
        float nx = ey * hz - ez * hy, ny = ez * hx - ex * hz, nz = ex * hy - ey * hx;
        // (-a) is the point relative to corner a, and so on
        float s1 = (ey * nz - ez * ny) * -ax + (ez * nx - ex * nz) * -ay + (ex * ny - ey * nx) * -az;
        float s2 = (gy * nz - gz * ny) * -bx + (gz * nx - gx * nz) * -by + (gx * ny - gy * nx) * -bz;
        float s3 = (hy * nz - hz * ny) * -ux + (hz * nx - hx * nz) * -uy + (hx * ny - hy * nx) * -uz;
        float nn = nx * nx + ny * ny + nz * nz;
        float d;
        bool within = (s1 > 0.0f && s2 > 0.0f && s3 > 0.0f) || (s1 < 0.0f && s2 < 0.0f && s3 < 0.0f);
        if (within && nn > 1e-30f) {
            float along = nx * ax + ny * ay + nz * az;
            d = along * along / nn;
        } else {
            float k, rx, ry, rz, l;
            l = ex * ex + ey * ey + ez * ez;
            k = fminf(fmaxf(-(ex * ax + ey * ay + ez * az) / fmaxf(l, 1e-30f), 0.0f), 1.0f);
            rx = ax + k * ex; ry = ay + k * ey; rz = az + k * ez;
            d = rx * rx + ry * ry + rz * rz;
            l = gx * gx + gy * gy + gz * gz;
            k = fminf(fmaxf(-(gx * bx + gy * by + gz * bz) / fmaxf(l, 1e-30f), 0.0f), 1.0f);
            rx = bx + k * gx; ry = by + k * gy; rz = bz + k * gz;
            d = fminf(d, rx * rx + ry * ry + rz * rz);
            l = hx * hx + hy * hy + hz * hz;
            k = fminf(fmaxf(-(hx * ux + hy * uy + hz * uz) / fmaxf(l, 1e-30f), 0.0f), 1.0f);
            rx = ux + k * hx; ry = uy + k * hy; rz = uz + k * hz;
            d = fminf(d, rx * rx + ry * ry + rz * rz);
        }
        nearest = fminf(nearest, d);
        float la = sqrtf(ax * ax + ay * ay + az * az), lb = sqrtf(bx * bx + by * by + bz * bz);
        float lc = sqrtf(ux * ux + uy * uy + uz * uz);
        float volume = ax * (by * uz - bz * uy) + ay * (bz * ux - bx * uz) + az * (bx * uy - by * ux);
        float rest = la * lb * lc + (ax * bx + ay * by + az * bz) * lc
                   + (bx * ux + by * uy + bz * uz) * la + (ux * ax + uy * ay + uz * az) * lb;
        turn += atan2f(volume, rest);
    }
    // The sum of half solid angles is 2 pi inside.
    out[t] = (turn > 3.14159265f ? -1.0f : 1.0f) * sqrtf(nearest);
}

#ifdef __CUDACC__
#define DEVICE 1
#endif
#ifdef __CUDACC_RTC__
#define DEVICE 1
#endif
#ifdef DEVICE
extern "C" __global__ void fps(const float* p, long long* out, int points, int wanted) {
    __shared__ float place[3 * MOST];
    __shared__ float warp_far[8];
    __shared__ int warp_index[8];
    __shared__ int chosen;
    int tid = threadIdx.x;
    const float* cloud = p + (long long)blockIdx.x * points * 3;
    for (int i = tid; i < points * 3; i += 256) place[i] = cloud[i];
    float nearest[MOST / 256];
    for (int k = 0; k < MOST / 256; ++k) nearest[k] = 3.0e38f;
    __syncthreads();
    int current = 0;
    for (int s = 0; s < wanted; ++s) {
        if (tid == 0) out[(long long)blockIdx.x * wanted + s] = current;
        float cx = place[3 * current], cy = place[3 * current + 1], cz = place[3 * current + 2];
        float far = -1.0f;
        int index = 0;
        #pragma unroll
        for (int k = 0; k < MOST / 256; ++k) {
            int i = tid + 256 * k;
            if (i < points) {
                float x = place[3 * i] - cx, y = place[3 * i + 1] - cy, z = place[3 * i + 2] - cz;
                nearest[k] = fminf(nearest[k], x * x + y * y + z * z);
                if (nearest[k] > far) { far = nearest[k]; index = i; }
            }
        }
        for (int off = 16; off > 0; off >>= 1) {
            float other = __shfl_down_sync(0xffffffffu, far, off);
            int its = __shfl_down_sync(0xffffffffu, index, off);
            if (other > far || (other == far && its < index)) { far = other; index = its; }
        }
        if ((tid & 31) == 0) { warp_far[tid >> 5] = far; warp_index[tid >> 5] = index; }
        __syncthreads();
        if (tid == 0) {
            for (int w = 1; w < 8; ++w)
                if (warp_far[w] > far || (warp_far[w] == far && warp_index[w] < index)) {
                    far = warp_far[w]; index = warp_index[w];
                }
            chosen = index;
        }
        __syncthreads();
        current = chosen;
    }
}
#endif
