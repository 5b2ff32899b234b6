#include "detect.hpp"
#include "fit.hpp"
#include "profile.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>

namespace fl::metrology {
namespace {

constexpr double blend_fwhm = 2.0;        // nearer than this, two spots share their pixels
constexpr double same_fwhm = 0.4;         // nearer than this, it is one
constexpr double most_lost = 0.6;         // of the squared light: then too little of the spot is left
constexpr double most_unexplained = 0.08; // of what the profile explains
constexpr double doubt_chi2 = 15;         // what a pixel that was left out would have added to chi2, at least
constexpr double forgiven_pixels = 2;     // hot ones
constexpr double most_doubt = 0.7;        // pixels: what ordinary noise adds up to stays below
constexpr double poor_chi2 = 2.0;
constexpr double wing_fwhm = 6.0;    // farther than this, wings do not matter
constexpr double close_fwhm = 3.0;   // nearer than this, one fit moves the other
constexpr double pair_fwhm = 1.5;    // nearer than this, each alone does not settle beside the other
constexpr double split_sigma = 6;    // of chi2: then there is something to be seen
constexpr double split_pixels = 2.5; // left out: a hot pixel is one
constexpr double wide_q = 20;        // where a hidden neighbour is looked for
constexpr double least_share = 0.04; // of the peak
constexpr double narrow_fwhm_px = 4.5;
constexpr int neighbour_rounds = 5;

// The spots of one image, and which are near each other.
class Frame {
  public:
    Frame(const Scene &scene, const Profile &profile)
        : scene_(scene), image_(scene.image), background_(scene.background), settings_(scene.settings),
          profile_(profile), reach_(profile),
          typical_fwhm_(profile.fwhm_px(profile.half_width_px, profile.half_height_px)) {}

    // Drops a seed that leaves nothing to begin with: its place, height or flux is no number.
    void add(const Seed &seed) {
        const Ellipse e = ellipse_at(profile_, seed.x, seed.y);
        Fit fit;
        fit.seed = same_as_.size();
        same_as_.push_back(fit.seed);
        fit.x = seed.x, fit.y = seed.y, fit.height = seed.height, fit.saturated = seed.saturated;
        // the mean over 3 x 3 pixels sees the profile at about q = (2/3) / S
        fit.flux = seed.height * e.area() / profile_value(profile_, 0.67 / e.area());
        const float noise = background_.noise_at(seed.x, seed.y);
        fit.q_max = reach_(seed.height / (settings_.gain_e_adu * noise * noise));
        fit.orphaned = true; // not fitted yet
        if (std::isfinite(seed.x + seed.y + fit.flux)) fits_.push_back(fit);
    }

    void drop_doubles() {
        link(same_fwhm * typical_fwhm_);
        std::vector<char> keep(fits_.size(), 1);
        for (std::size_t i = 0; i < fits_.size(); ++i)
            for (const std::size_t j : near_[i])
                if (keep[j] != 0 && brighter(j, i)) forget(i, j, keep);
        erase_unless(keep);
    }

    // Brightest first, each with the light of its neighbours taken off; those that share pixels again and
    // again.
    void fit_all() {
        link(wing_fwhm * typical_fwhm_);
        std::vector<std::size_t> order(fits_.size());
        std::iota(order.begin(), order.end(), std::size_t{0});
        std::sort(order.begin(), order.end(), [this](auto a, auto b) { return brighter(a, b); });
        for (std::size_t k = 0; k < order.size(); ++k) {
            if (k + 1 < order.size()) fetch(fits_[order[k + 1]]);
            fit_one(order[k]);
        }
        split_blends();
        for (int round = 1; round < neighbour_rounds; ++round) {
            link(wing_fwhm * typical_fwhm_);
            for (std::size_t i = 0; i < fits_.size(); ++i) fit_again(i);
            drop_what_is_none();
        }
    }

    std::vector<Spot> spots() {
        link(blend_fwhm * typical_fwhm_);
        std::vector<Spot> out;
        for (std::size_t i = 0; i < fits_.size(); ++i) out.push_back(spot(fits_[i], !near_[i].empty()));
        return out;
    }

    // For each seed the index of its spot, or -1.
    std::vector<std::ptrdiff_t> spot_of_seeds() const {
        std::vector<std::ptrdiff_t> out(same_as_.size(), -1);
        for (std::size_t i = 0; i < fits_.size(); ++i) out[fits_[i].seed] = static_cast<std::ptrdiff_t>(i);
        for (std::size_t k = 0; k < out.size(); ++k) {
            std::size_t other = k;
            while (same_as_[other] != other) other = same_as_[other];
            out[k] = out[other];
        }
        return out;
    }

  private:
    void forget(std::size_t i, std::size_t for_j, std::vector<char> &keep) {
        keep[i] = 0;
        same_as_[fits_[i].seed] = fits_[for_j].seed;
    }
    bool brighter(std::size_t a, std::size_t b) const {
        return fits_[a].height > fits_[b].height || (fits_[a].height == fits_[b].height && a < b);
    }
    bool shares_pixels(std::size_t i) const {
        return std::any_of(near_[i].begin(), near_[i].end(), [&](std::size_t j) {
            return distance(fits_[i], fits_[j]) < close_fwhm * typical_fwhm_;
        });
    }
    static double distance(const Fit &a, const Fit &b) { return std::hypot(a.x - b.x, a.y - b.y); }

    // Does the light of `other` reach into the pixels of a spot, a tenth of the noise of one of them?
    bool reaches(const Fit &other, const Fit &fit, const Ellipse &e, float noise) const {
        const double gap = std::max(distance(other, fit) - std::sqrt(fit.q_max * std::max(e.xx, e.yy)), 0.0);
        const double light = other.flux * profile_value(profile_, gap * gap / e.area()) / e.area();
        return light > 0.1 * noise;
    }

    static Box box_of(const Fit &fit, const Ellipse &e, double q_max) {
        return {fit.x, fit.y, e.half_width(q_max), e.half_height(q_max)};
    }

    void fetch(const Fit &fit) const {
        const Ellipse e = ellipse_at(profile_, fit.x, fit.y);
        fetch_ahead(image_, box_of(fit, e, fit.q_max));
    }

    // The stamp of spot i without its neighbours.
    Cut prepare(std::size_t i, double q_max) {
        const Fit &fit = fits_[i];
        const Ellipse e = ellipse_at(profile_, fit.x, fit.y);
        const Cut cut = cut_out(scene_, box_of(fit, e, q_max), stamp_);
        const float noise = background_.noise_at(fit.x, fit.y);
        for (const std::size_t j : near_[i]) {
            const Fit &n = fits_[j];
            if (reaches(n, fit, e, noise)) take_off(n);
        }
        return cut;
    }

    void fit_again(std::size_t i) {
        if (!fits_[i].orphaned && !shares_pixels(i)) return;
        const std::size_t j = partner(i);
        if (j == i)
            fit_one(i);
        else if (i < j && !fit_pair(i, j))
            fit_one(i), fit_one(j);
    }

    // The only spot that is nearer to spot i than `pair_fwhm`, and to which no third one is; else i itself.
    std::size_t partner(std::size_t i) const {
        const std::size_t j = only_close(i);
        const bool saturated = fits_[i].saturated || fits_[j].saturated;
        return !saturated && only_close(j) == i ? j : i;
    }
    std::size_t only_close(std::size_t i) const {
        std::size_t found = i, count = 0;
        for (const std::size_t j : near_[i])
            if (distance(fits_[i], fits_[j]) < pair_fwhm * typical_fwhm_) found = j, ++count;
        return count == 1 ? found : i;
    }

    bool fit_pair(std::size_t i, std::size_t j) {
        const Cut cut = prepare_pair(i, j);
        if (cut.saturated || !solve_pair(stamp_, profile_, settings_, fits_[i], fits_[j])) return false;
        for (const std::size_t k : {i, j}) {
            fits_[k].truncated = cut.truncated, fits_[k].saturated = false, fits_[k].orphaned = false;
        }
        return true;
    }

    // The stamp of both spots without their neighbours.
    Cut prepare_pair(std::size_t i, std::size_t j) {
        const Fit &a = fits_[i], &b = fits_[j];
        const double q_max = std::max(a.q_max, b.q_max);
        const Ellipse e = ellipse_at(profile_, a.x, a.y);
        const Box both{0.5 * (a.x + b.x), 0.5 * (a.y + b.y), e.half_width(q_max) + 0.5 * std::fabs(a.x - b.x),
                       e.half_height(q_max) + 0.5 * std::fabs(a.y - b.y)};
        const Cut cut = cut_out(scene_, both, stamp_);
        std::vector<std::size_t> others;
        for (const std::size_t k : near_[i]) others.push_back(k);
        for (const std::size_t k : near_[j]) others.push_back(k);
        std::sort(others.begin(), others.end());
        others.erase(std::unique(others.begin(), others.end()), others.end());
        for (const std::size_t k : others)
            if (k != i && k != j) take_off(fits_[k]);
        return cut;
    }

    void take_off(const Fit &f) {
        subtract_profile(stamp_, shape_of(profile_, ellipse_at(profile_, f.x, f.y)), f.flux, f.x - stamp_.x0,
                         f.y - stamp_.y0, static_cast<float>(1 / settings_.gain_e_adu));
    }

    void fit_one(std::size_t i) {
        Fit &fit = fits_[i];
        const Cut cut = prepare(i, fit.q_max);
        fit.truncated = cut.truncated;
        fit.saturated = cut.saturated;
        solve(stamp_, profile_, settings_, true, fit);
        fit.orphaned = false;
    }

    // A spot that leaves a spot over was two.
    void split_blends() {
        const std::size_t n = fits_.size();
        for (std::size_t i = 0; i < n; ++i) {
            const Fit &f = fits_[i];
            const bool strange = (f.chi2 - 1) * f.freedom > split_sigma * std::sqrt(2 * f.freedom);
            if (f.saturated || !(f.flux > 0) || !(strange || f.left_out > split_pixels || !f.converged))
                continue;
            if (Seed left; left_over(i, left)) add(left);
        }
    }

    // The brightest place of what remains without spot i and its neighbours, if it is lit like a spot.
    bool left_over(std::size_t i, Seed &seed) {
        const Fit fit = fits_[i];
        const Ellipse e = ellipse_at(profile_, fit.x, fit.y);
        prepare(i, wide_q);
        subtract_profile(stamp_, shape_of(profile_, e), fit.flux, fit.x - stamp_.x0, fit.y - stamp_.y0,
                         static_cast<float>(1 / settings_.gain_e_adu));
        const double peak = fit.flux * profile_value(profile_, 0) / e.area();
        const double bar = peak * std::max(least_share, 5 * profile_.misfit);
        seed.height = 0;
        for (int y = 1; y + 1 < stamp_.height; ++y)
            for (int x = 1; x + 1 < stamp_.width; ++x) {
                const double away = std::hypot(stamp_.x0 + x - fit.x, stamp_.y0 + y - fit.y);
                const float middle = middle_of_nine(x, y);
                if (away > 0.4 * typical_fwhm_ && middle > seed.height && middle > bar)
                    seed = {static_cast<double>(stamp_.x0 + x), static_cast<double>(stamp_.y0 + y), middle,
                            middle};
            }
        return seed.height > 0;
    }

    // Median of 3 x 3 residuals, 0 where it does not stand out of the noise: no cosmic ray fills five of
    // nine.
    float middle_of_nine(int x, int y) const {
        std::array<float, 9> v;
        for (int k = 0; k < 9; ++k) v[k] = stamp_.value[(y + k / 3 - 1) * stamp_.width + x + k % 3 - 1];
        std::nth_element(v.begin(), v.begin() + 4, v.end());
        return v[4] > 3 * std::sqrt(stamp_.variance[y * stamp_.width + x]) ? v[4] : 0.0f;
    }

    bool is_spot(const Fit &f) const {
        const double sigma = f.flux / std::sqrt(f.var_flux);
        const double cap = f.saturated || f.truncated ? 0.98 : most_lost;
        return f.converged && is_finite(f) && sigma > settings_.threshold && f.lost < cap &&
               has_the_shape(f) && f.x > -0.5 && f.y > -0.5 && f.x < image_.width - 0.5 &&
               f.y < image_.height - 0.5;
    }

    static bool is_finite(const Fit &f) {
        const double all = f.x + f.y + f.flux + f.background + f.chi2 + f.var_flux;
        return std::isfinite(all) && f.var_x > 0 && f.var_y > 0 &&
               std::isfinite(f.var_x + f.var_y + f.cov_xy);
    }

    // What the profile leaves over, against what it explains: tracks and clusters are not shaped like spots,
    // and a spot that a cosmic ray hits is, but for the pixels of the ray. A poor profile must not judge
    // strictly.
    bool has_the_shape(const Fit &f) const {
        // in a frame that has no spot to measure a profile on, nothing is likely to be one; but where all are
        // saturated they are not kept from the user
        if (!profile_.measured() && f.chi2 > poor_chi2) return f.saturated;
        const double left_over = (f.chi2 - 1) * f.freedom - 3 * std::sqrt(2 * f.freedom);
        const double thrown_out = doubt_chi2 * std::max(f.left_out - forgiven_pixels, 0.0);
        const double allowed = most_unexplained + 10 * profile_.misfit * profile_.misfit;
        return left_over + thrown_out < allowed * f.explained;
    }

    void drop_what_is_none() {
        std::vector<char> keep(fits_.size(), 1);
        for (std::size_t i = 0; i < fits_.size(); ++i) keep[i] = is_spot(fits_[i]);
        for (std::size_t i = 0; i < fits_.size(); ++i)
            for (const std::size_t j : near_[i]) {
                const bool one = distance(fits_[i], fits_[j]) < same_fwhm * typical_fwhm_;
                if (one && keep[i] != 0 && keep[j] != 0 && fits_[j].flux > fits_[i].flux) forget(i, j, keep);
            }
        // what was taken off for a spot that is none must be given back
        for (std::size_t i = 0; i < fits_.size(); ++i)
            if (keep[i] == 0)
                for (const std::size_t j : near_[i]) fits_[j].orphaned = true;
        erase_unless(keep);
    }

    void erase_unless(const std::vector<char> &keep) {
        std::size_t n = 0;
        for (std::size_t i = 0; i < fits_.size(); ++i)
            if (keep[i] != 0) fits_[n++] = fits_[i];
        fits_.resize(n);
    }

    // near_[i]: all others within a distance, by a sweep over y.
    void link(double distance) {
        near_.assign(fits_.size(), {});
        std::vector<std::size_t> order(fits_.size());
        std::iota(order.begin(), order.end(), std::size_t{0});
        std::sort(order.begin(), order.end(), [this](auto a, auto b) { return fits_[a].y < fits_[b].y; });
        for (std::size_t a = 0; a < order.size(); ++a)
            for (std::size_t b = a + 1; b < order.size(); ++b) {
                const Fit &p = fits_[order[a]], &q = fits_[order[b]];
                if (q.y - p.y > distance) break;
                if (std::fabs(p.x - q.x) > distance || std::hypot(p.x - q.x, p.y - q.y) > distance) continue;
                near_[order[a]].push_back(order[b]), near_[order[b]].push_back(order[a]);
            }
    }

    Spot spot(const Fit &f, bool in_blend) const {
        Spot s;
        s.x_px = f.x, s.y_px = f.y;
        // a guessed profile is wrong by what its residuals say
        const double doubt = profile_.measured() ? 1.0 : std::max(f.chi2, 1.0);
        s.var_x_px2 = doubt * f.var_x, s.cov_xy_px2 = doubt * f.cov_xy, s.var_y_px2 = doubt * f.var_y;
        s.flux_adu = f.flux, s.flux_err_adu = std::sqrt(f.var_flux);
        s.background_adu = background_.level_at(f.x, f.y) + f.background;
        s.chi2 = f.chi2;
        const auto flag = [](bool is, SpotFlag bit) { return is ? static_cast<std::uint32_t>(bit) : 0u; };
        s.flags = flag(f.saturated, saturated) | flag(in_blend, blended) | flag(f.truncated, truncated) |
                  flag(f.left_out > most_doubt, cosmic) | flag(f.chi2 > poor_chi2, poor_shape);
        return s;
    }

    const Scene &scene_;
    const ImageView &image_;
    const Background &background_;
    const Settings &settings_;
    const Profile &profile_;
    Reach reach_;
    double typical_fwhm_;
    Stamp stamp_;
    std::vector<Fit> fits_;
    std::vector<std::size_t> same_as_; // seed that turned out to be the same spot, itself otherwise
    std::vector<std::vector<std::size_t>> near_;
};

} // namespace

double Profile::fwhm_px(double x_px, double y_px) const {
    const double half = 0.5 * profile_value(*this, 0);
    double low = 0, high = 200;
    for (int k = 0; k < 50; ++k)
        (profile_value(*this, 0.5 * (low + high)) > half ? low : high) = 0.5 * (low + high);
    return 2 * std::sqrt(low * ellipse_at(*this, x_px, y_px).area());
}

namespace {

// Half the side of the box that detection climbs on: narrow spots near each other need a small one.
int climb_box(double fwhm_px) { return fwhm_px > 0 && fwhm_px < narrow_fwhm_px ? 1 : 2; }

Result measure(const Scene &scene, const std::vector<Seed> &found, const Profile &known,
               std::vector<std::ptrdiff_t> *of_seeds) {
    Result result;
    const double fwhm = known.measured() ? known.fwhm_px(known.half_width_px, known.half_height_px)
                                         : first_look_px(scene, found);
    const std::vector<Seed> seeds = of_seeds == nullptr ? gather_wide(scene, found, fwhm) : found;
    result.background_adu = scene.background.median_level(),
    result.noise_adu = scene.background.median_noise();
    result.profile = known.measured() ? known : measure_profile(scene, seeds);
    Frame frame(scene, result.profile);
    for (const Seed &s : seeds) frame.add(s);
    frame.drop_doubles();
    frame.fit_all();
    result.spots = frame.spots();
    if (of_seeds != nullptr) *of_seeds = frame.spot_of_seeds();
    return result;
}

} // namespace

Result find_spots(const ImageView &image, const Settings &settings, const Profile &known) {
    const Background background = measure_background(image);
    const Scene scene{image, background, settings};
    const double fwhm = known.measured() ? known.fwhm_px(known.half_width_px, known.half_height_px) : 0.0;
    std::vector<Seed> seeds = detect(scene, climb_box(fwhm));
    if (!known.measured()) {
        // once more, now that the size of the spots is known
        const int box = climb_box(first_look_px(scene, seeds));
        if (box != climb_box(0)) seeds = detect(scene, box);
    }
    return measure(scene, seeds, known, nullptr);
}

Result find_expected(const ImageView &image, const Settings &settings, std::span<const double> expected_xy_px,
                     double radius_px, const Profile &known) {
    const Background background = measure_background(image);
    const Scene scene{image, background, settings};
    const std::size_t n = expected_xy_px.size() / 2;
    const int box =
        climb_box(known.measured() ? known.fwhm_px(known.half_width_px, known.half_height_px) : 0.0);
    std::vector<Seed> seeds;
    std::vector<std::size_t> owner;
    for (std::size_t i = 0; i < n; ++i) {
        const double x = expected_xy_px[2 * i], y = expected_xy_px[2 * i + 1];
        if (Seed seed; detect_near(scene, box, {x, y, radius_px}, seed))
            seeds.push_back(seed), owner.push_back(i);
    }
    std::vector<std::ptrdiff_t> of_seeds;
    Result result = measure(scene, seeds, known, &of_seeds);
    std::vector<int> claims(result.spots.size(), 0);
    for (const std::ptrdiff_t j : of_seeds)
        if (j >= 0) ++claims[static_cast<std::size_t>(j)];
    std::vector<Spot> found(n);
    for (std::size_t k = 0; k < owner.size(); ++k) {
        if (of_seeds[k] < 0) continue;
        const auto j = static_cast<std::size_t>(of_seeds[k]);
        found[owner[k]] = result.spots[j];
        if (claims[j] > 1) found[owner[k]].flags |= shared;
    }
    result.spots = std::move(found);
    return result;
}

} // namespace fl::metrology
