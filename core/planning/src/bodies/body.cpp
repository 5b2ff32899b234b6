#include "bodies/body.hpp"

#include "motion/near_pairs.hpp"

#include <limits>

namespace fl::planning {
namespace {

double farthest(const Segment &line) { return std::max(length(line.a), length(line.b)); }

double distance_of_ends(const Segment &line, Vec2 from) {
    return std::max(length(line.a - from), length(line.b - from));
}

} // namespace

ArmBodies::ArmBodies(const Bodies &bodies) : shapes_(static_cast<int>(bodies.arms.size())) {
    radius_mm_ = std::numeric_limits<double>::infinity();
    for (const auto &parts : bodies.parts)
        for (const Part &part : parts) radius_mm_ = std::min(radius_mm_, part.radius_mm);
    for (int k = 0; k < shapes_.size(); ++k) {
        const PositionerIndex i(k);
        const auto &parts = row(bodies.parts, i);
        const Arm &arm = row(bodies.arms, i);
        bodies_.push_back(is_plain(parts) ? plain(arm, parts.front()) : shaped(arm, parts, shapes_[k]));
    }
}

// A capsule on the axis of the beta arm.
bool ArmBodies::is_plain(const std::vector<Part> &parts) {
    const Part &part = parts.front();
    return parts.size() == 1 && !part.on_alpha && part.layers == first_layer && part.line.a.y == 0.0 &&
           part.line.b.y == 0.0;
}

ArmBody ArmBodies::plain(const Arm &arm, const Part &part) const {
    return {arm, part.line.a.x, part.line.b.x, part.radius_mm - radius_mm_, nullptr, farthest(part.line),
            0.0};
}

// The centre line is as long as its parts reach along the beta arm; its radius is that of a capsule that
// holds them all, whatever the angle between the arms is.
ArmBody ArmBodies::shaped(const Arm &arm, const std::vector<Part> &parts, Shape &shape) const {
    constexpr double shortest_mm = 1.0;
    ArmBody body{arm, 0.0, shortest_mm, 0.0, &shape, shortest_mm, 0.0};
    for (const Part &part : parts)
        if (!part.on_alpha) body.to_mm = std::max({body.to_mm, part.line.a.x, part.line.b.x});
    shape.centre_mm = arm.centre_mm;
    shape.l_alpha_mm = arm.l_alpha_mm;
    shape.line_mm = body.to_mm;
    const Segment line{{0.0, 0.0}, {body.to_mm, 0.0}};
    double radius = 0.0;
    for (const Part &part : parts) {
        const Segment &s = part.line;
        shape.limbs.push_back({s, part.radius_mm - radius_mm_, part.on_alpha, part.layers});
        const double off = part.on_alpha ? distance_of_ends(s, {arm.l_alpha_mm, 0.0})
                                         : std::max(distance({s.a, s.a}, line), distance({s.b, s.b}, line));
        radius = std::max(radius, off + part.radius_mm);
        double &far = part.on_alpha ? body.alpha_far_mm : body.far_mm;
        far = std::max(far, farthest(s));
    }
    body.far_mm = std::max(body.far_mm, body.to_mm);
    body.extra_mm = radius - radius_mm_;
    return body;
}

List<Reach> ArmBodies::reaches() const {
    List<Reach> out;
    for (const ArmBody &body : bodies_) out.push_back({body.arm.centre_mm, body.reach_mm() + body.extra_mm});
    return out;
}

} // namespace fl::planning
