#include "profile.hpp"
#include "pixels.hpp"

#include <algorithm>
#include <numeric>

namespace fl::metrology {
namespace {

constexpr double fwhm_per_sigma = 2.354820045;
constexpr double fallback_fwhm_px = 3.0;
constexpr double wide_fwhm_px = 8.0; // detection climbs on 5 x 5 pixels
constexpr double wing_q = 60.0;      // the profile is measured to here
constexpr double core_q = 12.0;      // and the spots it is measured on are fitted to here
constexpr double peaked_misfit = 0.02;
constexpr int cells = 8; // per axis: bright spots are taken from everywhere in the image

struct Sample {
    double x, y;
    Ellipse s;
    bool good = true;
};

double median_of(std::vector<double> values) {
    if (values.empty()) return 0;
    const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
    std::nth_element(values.begin(), middle, values.end());
    return *middle;
}

// How far from (x, y) the light falls below half, in one direction, between pixels; a pixel that holds none
// is dark.
template <class P> double half_way(const Pixels<P> &pixels, int x, int y, int dx, int dy, float half) {
    float before = pixels.at(x, y);
    for (int k = 1; k < 100; ++k) {
        const int u = x + k * dx, v = y + k * dy;
        if (!pixels.inside(u, v)) return k;
        const float here = pixels.at(u, v);
        if (std::isnan(here)) return k - 0.5;
        if (!(here > half)) return k - 1.0 + (before - half) / std::max(before - here, 1e-6f);
        before = here;
    }
    return 100;
}

double half_maximum_width(const ImageView &image, const Background &background, const Seed &s) {
    return with_pixels(image, [&](const auto &pixels) {
        const int x = static_cast<int>(std::lround(s.x)), y = static_cast<int>(std::lround(s.y));
        const float level = background.level_at(x, y);
        if (std::isnan(pixels.at(x, y))) return 1.0;
        const float half = level + 0.5f * (pixels.at(x, y) - level);
        const double w = half_way(pixels, x, y, 1, 0, half) + half_way(pixels, x, y, -1, 0, half);
        const double h = half_way(pixels, x, y, 0, 1, half) + half_way(pixels, x, y, 0, -1, half);
        return std::sqrt(w * h);
    });
}

// Bright and unsaturated, a fair share from every cell of the image, brightest first.
std::vector<const Seed *> bright_seeds(const ImageView &image, const std::vector<Seed> &seeds, int most) {
    std::vector<const Seed *> order;
    for (const Seed &s : seeds)
        if (!s.saturated && s.lowest > 0) order.push_back(&s);
    // the faintest neighbours tell spots from cosmic rays, which are one or two pixels wide
    std::sort(order.begin(), order.end(), [](auto *a, auto *b) { return a->lowest > b->lowest; });
    const int share = std::max(3, 3 * most / (cells * cells));
    std::array<int, cells * cells> taken{};
    std::vector<const Seed *> out;
    for (const Seed *s : order) {
        const int i = whole(s->x * cells / image.width, 0, cells - 1);
        const int j = whole(s->y * cells / image.height, 0, cells - 1);
        if (++taken[static_cast<std::size_t>(j * cells + i)] <= share) out.push_back(s);
        if (static_cast<int>(out.size()) >= most) break;
    }
    return out;
}

// Seeds by column strip, to ask which are near.
class Neighbours {
  public:
    explicit Neighbours(const std::vector<Seed> &seeds) {
        for (const Seed &s : seeds) by_y_.push_back(&s);
        std::sort(by_y_.begin(), by_y_.end(), [](auto *a, auto *b) { return a->y < b->y; });
    }
    bool lonely(const Seed &s, double distance) const {
        auto it = std::lower_bound(by_y_.begin(), by_y_.end(), s.y - distance,
                                   [](const Seed *a, double y) { return a->y < y; });
        for (; it != by_y_.end() && (*it)->y < s.y + distance; ++it) {
            const double d = std::hypot((*it)->x - s.x, (*it)->y - s.y);
            if (*it != &s && d < distance && (*it)->height > 0.01f * s.height) return false;
        }
        return true;
    }

  private:
    std::vector<const Seed *> by_y_;
};

// Pixels far above the middle of their neighbours are not the spot's.
void drop_spikes(Stamp &stamp) {
    const std::vector<float> value = stamp.value;
    for (int j = 1; j + 1 < stamp.height; ++j)
        for (int i = 1; i + 1 < stamp.width; ++i) {
            const std::size_t at = static_cast<std::size_t>(j * stamp.width + i), w = stamp.width;
            std::array<float, 4> n{value[at - 1], value[at + 1], value[at - w], value[at + w]};
            std::sort(n.begin(), n.end());
            const float bar = 2.5f * std::max(n[2], 0.0f) + 6.0f * std::sqrt(stamp.variance[at]);
            if (value[at] > bar) stamp.usable[at] = 0.0f, stamp.value[at] = 0.5f * (n[1] + n[2]);
            if (stamp.usable[at] == 0.0f && value[at] > bar) stamp.usable[at] = 1.0f; // filled in
        }
}

// Fixed point of S = (M^-1 - S^-1)^-1, M the second moments under a Gaussian weight of shape S.
bool adaptive_moments(const Stamp &stamp, Sample &sample) {
    double x = sample.x - stamp.x0, y = sample.y - stamp.y0;
    Ellipse &s = sample.s;
    for (int k = 0; k < 30; ++k) {
        const double det = s.xx * s.yy - s.xy * s.xy;
        const Shape shape{static_cast<float>(s.yy / det),
                          static_cast<float>(-2 * s.xy / det),
                          static_cast<float>(s.xx / det),
                          {}};
        const auto m = weighted_moments(stamp, shape, x, y);
        if (!(m[0] > 0)) return false;
        const double ux = m[1] / m[0], uy = m[2] / m[0];
        const double mxx = m[3] / m[0] - ux * ux, mxy = m[4] / m[0] - ux * uy, myy = m[5] / m[0] - uy * uy;
        const double mdet = mxx * myy - mxy * mxy;
        const double ixx = myy / mdet - s.yy / det, ixy = -mxy / mdet + s.xy / det,
                     iyy = mxx / mdet - s.xx / det;
        const double idet = ixx * iyy - ixy * ixy;
        if (!(mdet > 0 && idet > 0 && ixx > 0)) return false;
        const Ellipse next{iyy / idet, -ixy / idet, ixx / idet};
        if (!next.sound()) return false;
        const double change = std::fabs(next.xx - s.xx) + std::fabs(next.yy - s.yy);
        x += 2 * ux, y += 2 * uy; // the weight halves the way
        s = next;
        if (change < 1e-3 * (s.xx + s.yy)) break;
    }
    sample.x = stamp.x0 + x, sample.y = stamp.y0 + y;
    return true;
}

std::array<double, Profile::terms> terms_at(const Profile &p, double x, double y) {
    return polynomial_terms(x / p.half_width_px - 1, y / p.half_height_px - 1);
}

// As much freedom as eight spots for each number allow: degree 4, 3, 2, 1 or none.
int terms_for(int n_spots) {
    for (const int terms : {15, 10, 6, 3})
        if (n_spots >= 8 * terms) return terms;
    return 1;
}

// Least squares by the normal equations, Gauss with pivots; small and well scaled.
std::vector<double> least_squares(std::vector<std::vector<double>> a, std::vector<double> b) {
    const std::size_t n = b.size();
    for (std::size_t i = 0; i < n; ++i) {
        std::size_t pivot = i;
        for (std::size_t r = i + 1; r < n; ++r)
            if (std::fabs(a[r][i]) > std::fabs(a[pivot][i])) pivot = r;
        std::swap(a[i], a[pivot]), std::swap(b[i], b[pivot]);
        for (std::size_t r = i + 1; r < n; ++r) {
            const double f = a[r][i] / a[i][i];
            for (std::size_t c = i; c < n; ++c) a[r][c] -= f * a[i][c];
            b[r] -= f * b[i];
        }
    }
    for (std::size_t i = n; i-- > 0;) {
        for (std::size_t c = i + 1; c < n; ++c) b[i] -= a[i][c] * b[c];
        b[i] /= a[i][i];
    }
    return b;
}

double component(const Ellipse &e, std::size_t k) { return k == 0 ? e.xx : k == 1 ? e.xy : e.yy; }

void fit_component(Profile &p, const std::vector<Sample> &samples, int n, std::size_t k) {
    std::vector<std::vector<double>> a(static_cast<std::size_t>(n), std::vector<double>(n, 0.0));
    std::vector<double> b(static_cast<std::size_t>(n), 0.0);
    for (const Sample &s : samples) {
        if (!s.good) continue;
        const auto t = terms_at(p, s.x, s.y);
        for (int i = 0; i < n; ++i) {
            b[i] += t[i] * component(s.s, k);
            for (int j = 0; j < n; ++j) a[i][j] += t[i] * t[j];
        }
    }
    for (int i = 0; i < n; ++i) a[i][i] *= 1 + 1e-9, a[i][i] += 1e-9;
    const auto c = least_squares(a, b);
    p.shape[k].fill(0);
    std::copy(c.begin(), c.end(), p.shape[k].begin());
}

// Forgets samples whose size or shape is far from the others': blends, ghosts, cosmic rays.
int clip_samples(const Profile &p, std::vector<Sample> &samples) {
    std::vector<double> off;
    for (const Sample &s : samples) {
        const Ellipse e = ellipse_at(p, s.x, s.y);
        off.push_back(std::hypot(s.s.xx - e.xx, 2 * (s.s.xy - e.xy), s.s.yy - e.yy) / (e.xx + e.yy));
    }
    std::vector<double> kept;
    for (std::size_t i = 0; i < samples.size(); ++i)
        if (samples[i].good) kept.push_back(off[i]);
    const double bar = std::max(4 * median_of(kept), 0.01);
    int n = 0;
    for (std::size_t i = 0; i < samples.size(); ++i) n += samples[i].good = off[i] < bar;
    return n;
}

// Starts from the median shape: a majority of the samples are spots.
void fit_shapes(Profile &p, std::vector<Sample> &samples) {
    for (std::size_t k = 0; k < 3; ++k) {
        std::vector<double> v;
        for (const Sample &s : samples) v.push_back(component(s.s, k));
        p.shape[k].fill(0), p.shape[k][0] = median_of(v);
    }
    for (int round = 0; round < 4; ++round) {
        const int good = clip_samples(p, samples);
        const int terms = round < 2 ? std::min(terms_for(good), 6) : terms_for(good);
        for (std::size_t k = 0; k < 3; ++k) fit_component(p, samples, terms, k);
    }
}

struct ProfileSpot {
    Stamp stamp;
    Fit fit;
};

void add_spots(const Profile &profile, const Settings &settings, const std::vector<ProfileSpot> &spots,
               int round, LadderSums &sums) {
    constexpr float pi = 3.14159265f;
    for (const ProfileSpot &s : spots) {
        if (!s.fit.converged || !(s.fit.flux > 0)) continue;
        const Ellipse e = ellipse_at(profile, s.fit.x, s.fit.y);
        const auto norm = static_cast<float>(1 / (2 * pi * e.area()));
        const Judge judge{6.0f, round < 2 ? 0.3f : 0.05f, 0.0f, static_cast<float>(1 / settings.gain_e_adu),
                          120.0f};
        const FitState state{s.fit.flux, s.fit.x - s.stamp.x0, s.fit.y - s.stamp.y0, 0};
        add_ladder(s.stamp, shape_of(profile, e), norm, state, judge, sums);
    }
}

// Amplitudes from the sums, with a weak wish for a single Gaussian, normalised to flux 1.
void take_ladder(const LadderSums &sums, Profile &profile) {
    std::vector<std::vector<double>> a(6, std::vector<double>(6));
    std::vector<double> b(sums.begin() + 21, sums.begin() + 27);
    std::size_t n = 0;
    for (std::size_t i = 0; i < 6; ++i)
        for (std::size_t j = i; j < 6; ++j) a[i][j] = a[j][i] = sums[n++];
    for (std::size_t i = 0; i < 6; ++i) {
        const double wish = 1e-6 * a[1][1];
        a[i][i] += wish, b[i] += i == 1 && !profile.flat_top ? wish : 0.0;
    }
    const auto c = least_squares(a, b);
    double flux = 0;
    const auto weights = rung_weights(profile);
    for (std::size_t k = 0; k < 6; ++k) flux += c[k] * weights[k];
    if (!(flux > 0 && std::isfinite(flux))) return;
    for (std::size_t k = 0; k < 6; ++k) profile.amplitude[k] = c[k] / flux;
}

void fit_ladder(Profile &profile, const Settings &settings, std::vector<ProfileSpot> &spots) {
    profile.misfit = 0.05;
    for (int round = 0; round < 4; ++round) {
        for (ProfileSpot &s : spots) solve(s.stamp, profile, settings, false, s.fit);
        LadderSums sums{};
        add_spots(profile, settings, spots, round, sums);
        take_ladder(sums, profile);
        profile.misfit =
            std::clamp(std::sqrt(std::max(sums[27], 0.0) / std::max(sums[28], 1e-300)), 0.001, 0.2);
    }
}

// Peaked profiles first; where they do not fit, flat tops.
void fit_profile(Profile &profile, const Settings &settings, std::vector<ProfileSpot> &spots) {
    std::vector<ProfileSpot> again = spots;
    fit_ladder(profile, settings, spots);
    if (profile.misfit < peaked_misfit) return;
    Profile flat = profile;
    flat.flat_top = true;
    flat.amplitude = {0, 0, 1, 0, 0, 0};
    for (double &a : flat.amplitude) a /= rung_weights(flat)[2];
    fit_ladder(flat, settings, again);
    if (flat.misfit < profile.misfit) profile = flat;
}

Profile round_profile(const ImageView &image, double fwhm_px) {
    Profile p;
    p.half_width_px = 0.5 * std::max(image.width - 1, 1),
    p.half_height_px = 0.5 * std::max(image.height - 1, 1);
    const double s = fwhm_px * fwhm_px / (fwhm_per_sigma * fwhm_per_sigma);
    p.shape[0][0] = p.shape[2][0] = s;
    p.misfit = 0.03; // not known, but a spot is round
    return p;
}

// Centre of light under a round Gaussian weight, moved along until it no longer moves.
void centre_on_light(const Scene &scene, double fwhm_px, Seed &seed) {
    const float s = static_cast<float>(fwhm_per_sigma * fwhm_per_sigma / (fwhm_px * fwhm_px));
    const Shape weight{s, 0, s, {}};
    Stamp stamp;
    const double x1 = scene.image.width - 0.5, y1 = scene.image.height - 0.5;
    for (int k = 0; k < 5; ++k) {
        cut_out(scene, {seed.x, seed.y, 1.5 * fwhm_px, 1.5 * fwhm_px}, stamp);
        const auto m = weighted_moments(stamp, weight, seed.x - stamp.x0, seed.y - stamp.y0);
        const double x = seed.x + 2 * m[1] / m[0], y = seed.y + 2 * m[2] / m[0];
        // light of a weight near 0 leads anywhere
        if (!(m[0] > 0 && x > -0.5 && y > -0.5 && x < x1 && y < y1)) return;
        seed.x = x, seed.y = y;
    }
}

// lonely spots tell the wings; where there are none, the core must do
std::vector<const Seed *> lonely_seeds(const std::vector<Seed> &seeds, std::vector<const Seed *> bright,
                                       double fwhm) {
    const Neighbours neighbours(seeds);
    for (const double distance : {6.0, 4.0, 2.5, 1.5}) {
        std::vector<const Seed *> lonely;
        for (const Seed *s : bright)
            if (neighbours.lonely(*s, distance * fwhm)) lonely.push_back(s);
        if (lonely.size() >= 20 || (distance < 2 && !lonely.empty())) return lonely;
    }
    return bright;
}

std::vector<Sample> sample_shapes(const Scene &scene, const std::vector<const Seed *> &bright, double fwhm) {
    const double s = fwhm * fwhm / (fwhm_per_sigma * fwhm_per_sigma);
    std::vector<Sample> samples;
    Stamp stamp;
    for (const Seed *seed : bright) {
        Sample sample{seed->x, seed->y, {s, 0, s}};
        cut_out(scene, {seed->x, seed->y, 2 * fwhm, 2 * fwhm}, stamp);
        drop_spikes(stamp);
        if (adaptive_moments(stamp, sample)) samples.push_back(sample);
    }
    return samples;
}

std::vector<ProfileSpot> cut_wide(const Scene &scene, const Profile &profile,
                                  const std::vector<Sample> &samples) {
    std::vector<ProfileSpot> spots;
    for (const Sample &s : samples) {
        if (!s.good) continue;
        ProfileSpot &spot = spots.emplace_back();
        const Ellipse e = ellipse_at(profile, s.x, s.y);
        cut_out(scene, {s.x, s.y, e.half_width(wing_q), e.half_height(wing_q)}, spot.stamp);
        spot.fit.x = s.x, spot.fit.y = s.y, spot.fit.q_max = core_q;
        // a Gaussian under its own weight gives half its flux
        spot.fit.flux = 2 * weighted_moments(spot.stamp, shape_of(profile, e), s.x - spot.stamp.x0,
                                             s.y - spot.stamp.y0)[0];
    }
    return spots;
}

} // namespace

double first_look_px(const Scene &scene, const std::vector<Seed> &seeds) {
    std::vector<double> widths;
    for (const Seed *s : bright_seeds(scene.image, seeds, scene.settings.max_profile_spots))
        widths.push_back(half_maximum_width(scene.image, scene.background, *s));
    return widths.empty() ? 0.0 : std::clamp(median_of(widths), 1.0, 100.0);
}

std::vector<Seed> gather_wide(const Scene &scene, const std::vector<Seed> &seeds, double fwhm_px) {
    if (fwhm_px < wide_fwhm_px) return seeds;
    std::vector<Seed> order = seeds, out;
    std::sort(order.begin(), order.end(), [](const Seed &a, const Seed &b) { return a.height > b.height; });
    for (Seed &s : order) {
        if (!s.saturated) centre_on_light(scene, fwhm_px, s);
        const bool known = std::any_of(out.begin(), out.end(), [&](const Seed &o) {
            return std::hypot(o.x - s.x, o.y - s.y) < 0.5 * fwhm_px;
        });
        if (!known) out.push_back(s);
    }
    return out;
}

Profile measure_profile(const Scene &scene, const std::vector<Seed> &seeds) {
    const double look = first_look_px(scene, seeds);
    const double hint = scene.settings.fwhm_px > 0 ? scene.settings.fwhm_px : fallback_fwhm_px;
    Profile profile = round_profile(scene.image, look > 0 ? look : hint);
    if (!(look > 0)) return profile;
    const auto bright =
        lonely_seeds(seeds, bright_seeds(scene.image, seeds, scene.settings.max_profile_spots), look);
    std::vector<Sample> samples = sample_shapes(scene, bright, look);
    if (samples.empty()) return profile;
    const Profile round = profile;
    fit_shapes(profile, samples);
    if (!ellipse_at(profile, profile.half_width_px, profile.half_height_px).sound()) return round;
    std::vector<ProfileSpot> spots = cut_wide(scene, profile, samples);
    fit_profile(profile, scene.settings, spots);
    profile.n_spots = static_cast<int>(spots.size());
    return profile;
}

} // namespace fl::metrology
