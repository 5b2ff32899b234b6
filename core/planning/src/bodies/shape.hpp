// A body of several limbs, and the tests of its limbs one by one.
//
// The pose of both arms is told by the centre line of the body: it begins at the beta axis and runs along
// the beta arm. Every point of a limb is a linear function of the ends of this line, so limbs whose
// body moves on chords move on chords.
#pragma once

#include "fiberloom/planning.hpp"
#include "motion/index.hpp"
#include "motion/swept_arm.hpp"

namespace fl::planning {

struct Limb {
    Segment line; // in the frame of its arm
    double extra_mm = 0.0;
    bool on_alpha = false;
    Layers layers = first_layer;
};

// The frames of both arms at one place: their origins, and their x axes as unit vectors.
struct Pose {
    Vec2 alpha_at, alpha_x, beta_at, beta_x;
};

struct Shape {
    Vec2 centre_mm;
    double l_alpha_mm = 0.0;
    double line_mm = 0.0; // length of the centre line
    List<Limb> limbs;
    // Where the arms are when the centre line is there ...
    Pose pose(const Segment &line) const {
        const double a = 1.0 / l_alpha_mm, b = 1.0 / line_mm;
        const Vec2 alpha = line.a - centre_mm, beta = line.b - line.a;
        return {centre_mm, {alpha.x * a, alpha.y * a}, line.a, {beta.x * b, beta.y * b}};
    }
    // ... and a limb.
    Segment place(const Limb &limb, const Segment &line) const;
};

inline Segment placed(const Limb &limb, const Pose &pose) {
    const Vec2 at = limb.on_alpha ? pose.alpha_at : pose.beta_at;
    const Vec2 x = limb.on_alpha ? pose.alpha_x : pose.beta_x;
    const Segment &s = limb.line;
    return {{at.x + s.a.x * x.x - s.a.y * x.y, at.y + s.a.x * x.y + s.a.y * x.x},
            {at.x + s.b.x * x.x - s.b.y * x.y, at.y + s.b.x * x.y + s.b.y * x.x}};
}

// A body as limbs; one without a shape is a single limb, its own centre line.
class Limbs {
  public:
    explicit Limbs(const SweptArm &body) : body_(body) {}
    int size() const { return body_.shape == nullptr ? 1 : body_.shape->limbs.size(); }
    Segment at(int k, const Segment &line) const {
        return body_.shape == nullptr ? line : body_.shape->place(body_.shape->limbs[k], line);
    }
    double extra_mm(int k) const {
        return body_.shape == nullptr ? body_.extra_mm : body_.shape->limbs[k].extra_mm;
    }
    bool on_alpha(int k) const { return body_.shape != nullptr && body_.shape->limbs[k].on_alpha; }
    Layers layers(int k) const {
        return body_.shape == nullptr ? body_.layers : body_.shape->limbs[k].layers;
    }

  private:
    const SweptArm &body_;
};

// The limbs of a body at one place.
class PlacedLimbs {
  public:
    PlacedLimbs(const SweptArm &body, const Segment &line) : shape_(body.shape), line_(line) {
        if (shape_ != nullptr) pose_ = shape_->pose(line);
    }
    Segment at(int k) const { return shape_ == nullptr ? line_ : placed(shape_->limbs[k], pose_); }

  private:
    const Shape *shape_;
    Segment line_;
    Pose pose_;
};

inline bool may_touch(const Limbs &p, int a, const Limbs &q, int b) {
    return (p.layers(a) & q.layers(b)) != 0 && !(p.on_alpha(a) && q.on_alpha(b));
}

// Calls test(a, b, need_mm) for all limbs that can touch, until it is false.
template <class Test> bool all_limbs(const Limbs &p, const Limbs &q, double need_mm, Test test) {
    for (int a = 0; a < p.size(); ++a)
        for (int b = 0; b < q.size(); ++b)
            if (may_touch(p, a, q, b) && !test(a, b, need_mm + p.extra_mm(a) + q.extra_mm(b))) return false;
    return true;
}

// Where the bodies are so near to each other in mid-step that their limbs may be nearer than
// need_mm, or not.
bool limbs_within(const SweptArm &p, const Segment &p_line, const SweptArm &q, const Segment &q_line,
                  double need_mm);

// Whether two keep so far apart, beyond their extra radii, when their steps begin.
bool apart_at_first(const SweptArm &p, const SweptArm &q, double need_mm);

// An obstacle as a step; its radius is part of what is needed.
SweptArm resting_obstacle(const Capsule &obstacle);

// How far a point of a body gets, at most, when its centre line goes from one place to another.
double limbs_move_mm(const SweptArm &body, const Segment &from, const Segment &to);

// Whether bodies, at least one with a shape, stay apart by a test of the limbs that may come near.
bool limbs_apart(const SweptArm &p, const SweptArm &q, double need_mm, ChordsTest chords_are_apart);

} // namespace fl::planning
