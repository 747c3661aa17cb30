#include frame.wgsl
#include ray_hit.wgsl
// A level plane without end at HEIGHT metres.

fn lod_ray(ray: Ray, from_t: f32, to_t: f32) -> RayHit {
    let t = (lift(vec2<f32>(0.0), #{HEIGHT}).z - ray.origin.z) / ray.direction.z;
    if (!(t >= from_t && t <= to_t)) { return RayHit(MISS, 0u, 0u, 0u, 0.0); }
    return RayHit(t, #{ID}u, 1u, 4u, 2.5);
}
