// Spots in images. Images are read where they lie: no copy, no lock while reading.
#include "bind.hpp"
#include "fiberloom/expose.hpp"
#include "fiberloom/render.hpp"
#include "fiberloom/spots.hpp"
#include "fiberloom/waves.hpp"

#include <nanobind/stl/array.h>

#include <algorithm>
#include <cstdlib>
#include <mutex>
#include <new>
#include <utility>
#include <vector>

#if defined(__linux__)
#include <sys/mman.h>
#endif

namespace {

using namespace fl::metrology;
using Image = nb::ndarray<nb::ro, nb::ndim<2>, nb::device::cpu>;
using Positions = Input<double, -1, 2>;
constexpr size_t profile_size = Profile::components + 3 * Profile::terms + 5;

// `fits`: the bytes are those of an uncompressed FITS file, big-endian, 16 bits with BZERO 32768.
PixelType pixel_type(const Image &image, bool fits) {
    if (image.dtype() == nb::dtype<uint16_t>()) return fits ? PixelType::U16Fits : PixelType::U16;
    if (image.dtype() == nb::dtype<uint32_t>() && fits) return PixelType::F32Fits;
    if (image.dtype() == nb::dtype<float>()) return PixelType::F32;
    if (image.dtype() == nb::dtype<double>()) return PixelType::F64;
    throw nb::value_error("image: pixels must be uint16, float32 or float64");
}

ImageView view(const Image &image, bool fits) {
    if (image.shape(0) < 8 || image.shape(1) < 8) throw nb::value_error("image: at least 8 x 8 pixels");
    if (image.stride(1) != 1) throw nb::value_error("image: the pixels of a row must be adjacent");
    const auto size = static_cast<ptrdiff_t>(image.itemsize());
    return {static_cast<const std::byte *>(image.data()), image.stride(0) * size,
            static_cast<int>(image.shape(1)), static_cast<int>(image.shape(0)), pixel_type(image, fits)};
}

Output<double, -1> packed(const Profile &p) {
    auto out = new_array<double, -1>({profile_size});
    double *v = std::copy(p.amplitude.begin(), p.amplitude.end(), out.data());
    for (const auto &s : p.shape) v = std::copy(s.begin(), s.end(), v);
    *v++ = p.flat_top ? 1 : 0, *v++ = p.half_width_px, *v++ = p.half_height_px, *v++ = p.misfit,
    *v++ = p.n_spots;
    return out;
}

Profile unpacked(const Input1<double> &in) {
    if (in.shape(0) == 0) return {};
    if (in.shape(0) != profile_size) throw nb::value_error("profile: not one that find_spots returned");
    Profile p;
    const double *v = in.data();
    for (double &a : p.amplitude) a = *v++;
    for (auto &s : p.shape)
        for (double &c : s) c = *v++;
    p.flat_top = *v++ > 0, p.half_width_px = *v++, p.half_height_px = *v++, p.misfit = *v++,
    p.n_spots = static_cast<int>(*v);
    return p;
}

// Spots (N, 9), flags (N,), the profile, background and noise in ADU.
using Table = std::tuple<Output<double, -1, 9>, Output<uint32_t, -1>, Output<double, -1>, double, double>;

Table table(const Result &r) {
    const size_t n = r.spots.size();
    auto numbers = new_array<double, -1, 9>({n, 9});
    auto flags = new_array<uint32_t, -1>({n});
    for (size_t i = 0; i < n; ++i) {
        const Spot &s = r.spots[i];
        const double row[] = {s.x_px,     s.y_px,         s.var_x_px2,      s.cov_xy_px2, s.var_y_px2,
                              s.flux_adu, s.flux_err_adu, s.background_adu, s.chi2};
        std::copy(std::begin(row), std::end(row), numbers.data() + 9 * i);
        flags.data()[i] = s.flags;
    }
    return {numbers, flags, packed(r.profile), r.background_adu, r.noise_adu};
}

void settings_init(Settings *self, double gain, double saturation, double threshold, double fwhm) {
    Settings s;
    s.gain_e_adu = gain, s.saturation_adu = saturation, s.threshold = threshold, s.fwhm_px = fwhm;
    new (self) Settings(s);
}

Table find(Image image, bool fits, const Settings &settings, Input1<double> profile) {
    const ImageView v = view(image, fits);
    const Profile known = unpacked(profile);
    Result r;
    {
        nb::gil_scoped_release release;
        r = find_spots(v, settings, known);
    }
    return table(r);
}

Table expected(Image image, bool fits, const Settings &settings, Input1<double> profile, Positions xy,
               double radius) {
    const ImageView v = view(image, fits);
    const Profile known = unpacked(profile);
    Result r;
    {
        nb::gil_scoped_release release;
        r = find_expected(v, settings, {xy.data(), 2 * xy.shape(0)}, radius, known);
    }
    return table(r);
}

std::tuple<Output<double, -1>> widths(Input1<double> profile, Positions xy) {
    const Profile p = unpacked(profile);
    auto fwhm = new_array<double, -1>({xy.shape(0)});
    for (size_t i = 0; i < xy.shape(0); ++i)
        fwhm.data()[i] = p.fwhm_px(xy.data()[2 * i], xy.data()[2 * i + 1]);
    return {fwhm};
}

PsfKind kind_of(int kind) {
    if (kind < 0 || kind > 2) throw nb::value_error("kind: 0 Gaussian, 1 Moffat, 2 disc");
    return static_cast<PsfKind>(kind);
}

void render(nb::ndarray<float, nb::ndim<2>, nb::c_contig, nb::device::cpu> image,
            Input<double, -1, spot_columns> spots, int kind, double radius_q) {
    const PsfKind psf = kind_of(kind);
    nb::gil_scoped_release release;
    render_spots({image.data(), image.size()}, static_cast<int>(image.shape(1)),
                 static_cast<int>(image.shape(0)), {spots.data(), spots.size()}, psf, radius_q);
}

// Memory for large images. The last one that was given back is kept for the next of its size: the kernel
// wipes what it hands out, which takes longer than to make an image.
class ImageMemory {
  public:
    struct Block {
        void *data = nullptr;
        size_t bytes = 0;
    };

    static ImageMemory &one() {
        static ImageMemory *memory = new ImageMemory; // never destroyed: images may outlive all else
        return *memory;
    }

    // On Linux its pages are large, so that the kernel hands out a 512th as many of them.
    Block *take(size_t bytes) {
        constexpr size_t page_bytes = size_t{2} << 20;
        const size_t whole = (bytes + page_bytes - 1) / page_bytes * page_bytes;
        if (Block kept = exchange({}); kept.data != nullptr) {
            if (kept.bytes == whole) return new Block(kept);
            std::free(kept.data);
        }
        void *data = std::aligned_alloc(page_bytes, whole);
        if (data == nullptr) throw std::bad_alloc();
#if defined(__linux__)
        madvise(data, whole, MADV_HUGEPAGE); // where it is refused, pages are small
#endif
        return new Block{data, whole};
    }

    void give_back(Block *block) {
        std::free(exchange(*block).data);
        delete block;
    }

  private:
    Block exchange(Block block) {
        const std::lock_guard<std::mutex> guard(lock_);
        return std::exchange(kept_, block);
    }

    std::mutex lock_;
    Block kept_;
};

// An image whose every pixel is written by whoever asks for it: nothing is wiped first.
Output<uint16_t, -1, -1> new_image(size_t rows, size_t columns) {
    constexpr size_t large_bytes = size_t{4} << 20;
    const size_t bytes = rows * columns * sizeof(uint16_t);
    if (bytes >= large_bytes) {
        ImageMemory::Block *block = ImageMemory::one().take(bytes);
        nb::capsule owner(block, [](void *p) noexcept {
            ImageMemory::one().give_back(static_cast<ImageMemory::Block *>(p));
        });
        return Output<uint16_t, -1, -1>(block->data, {rows, columns}, owner);
    }
    return new_array<uint16_t, -1, -1>({rows, columns});
}

using Three = std::array<double, 3>;
using Four = std::array<double, 4>;

Exposure exposure_of(const Three &sky, const Four &detector, uint64_t seed, int threads) {
    return {{sky[0], sky[1], sky[2]}, {detector[0], detector[1], detector[2], detector[3]}, seed, threads};
}

Output<uint16_t, -1, -1> expose_image(Input2<float> light, Three sky, Four detector, uint64_t seed,
                                      int threads) {
    auto adu = new_image(light.shape(0), light.shape(1));
    const Exposure exposure = exposure_of(sky, detector, seed, threads);
    {
        nb::gil_scoped_release release;
        expose({light.data(), light.size()}, static_cast<int>(light.shape(1)), exposure,
               {adu.data(), light.size()});
    }
    return adu;
}

// `Lights` with what they are told by.
struct KeptLights {
    std::vector<double> spots;
    PsfKind kind;
    double radius_q;
    std::vector<int64_t> pixels;
    std::vector<float> electrons;
};

void lights_init(KeptLights *self, Input<double, -1, spot_columns> spots, int kind, double radius_q,
                 Input1<int64_t> pixels, Input1<float> electrons) {
    if (pixels.shape(0) != electrons.shape(0)) throw nb::value_error("electrons: a number for each pixel");
    const auto list = [](const auto &in) { return std::vector(in.data(), in.data() + in.size()); };
    new (self) KeptLights{list(spots), kind_of(kind), radius_q, list(pixels), list(electrons)};
}

Output<uint16_t, -1, -1> expose_painted(const KeptLights &lights, std::array<int, 2> shape, Three sky,
                                        Four detector, uint64_t seed, int threads) {
    if (shape[0] < 1 || shape[1] < 1) throw nb::value_error("shape: at least 1 x 1 pixels");
    const int64_t count = int64_t{shape[0]} * shape[1];
    const auto outside = [count](int64_t p) { return p < 0 || p >= count; };
    if (std::any_of(lights.pixels.begin(), lights.pixels.end(), outside))
        throw nb::value_error("pixels: one lies outside of the image");
    auto adu = new_image(static_cast<size_t>(shape[0]), static_cast<size_t>(shape[1]));
    const Lights seen{lights.spots, lights.kind, lights.radius_q, lights.pixels, lights.electrons};
    const Exposure exposure = exposure_of(sky, detector, seed, threads);
    {
        nb::gil_scoped_release release;
        expose_lights(seen, shape[1], exposure, {adu.data(), static_cast<size_t>(count)});
    }
    return adu;
}

Output<double, -1> wave_sums(Input<double, -1, 2> xy, Input<double, -1, wave_columns> waves) {
    auto sums = new_array<double, -1>({xy.shape(0)});
    nb::gil_scoped_release release;
    add_waves({xy.data(), xy.size()}, {waves.data(), waves.size()}, {sums.data(), xy.shape(0)});
    return sums;
}

} // namespace

void bind_metrology(nb::module_ &m) {
    nb::module_ g =
        m.def_submodule("metrology", "Detection and centroids; px, ADU. See fiberloom.metrology.");
    g.attr("COLUMNS") = "x_px y_px var_x_px2 cov_xy_px2 var_y_px2 flux_adu flux_err_adu background_adu chi2";
    nb::class_<Settings>(g, "Settings", "What is known of the camera, and what counts as a spot.")
        .def("__init__", &settings_init, nb::arg("gain_e_adu"), nb::arg("saturation_adu"),
             nb::arg("threshold"), nb::arg("fwhm_px"),
             "threshold: brightest pixel over the noise. fwhm_px: a hint for the first look, 0 for none.");
    // an image may have pixels of several types, which a C++ signature cannot tell a type checker
#define FL_NUMBERS "numpy.typing.NDArray[numpy.float64]"
#define FL_FIND                                                                                              \
    "image: numpy.typing.NDArray[typing.Any], fits: bool, settings: Settings, profile: " FL_NUMBERS
#define FL_TABLE "tuple[" FL_NUMBERS ", numpy.typing.NDArray[numpy.uint32], " FL_NUMBERS ", float, float]"
    g.def("find_spots", &find, nb::sig("def find_spots(" FL_FIND ") -> " FL_TABLE), nb::arg("image"),
          nb::arg("fits"), nb::arg("settings"), nb::arg("profile"),
          "Table (N, 9), flags (N,), profile, background and noise in ADU. The image is uint16, float32 or "
          "float64, or with `fits` the bytes of a FITS file as uint16 or uint32. profile: empty, or one that "
          "this function returned.");
    g.def("find_expected", &expected,
          nb::sig("def find_expected(" FL_FIND ", expected_xy_px: " FL_NUMBERS
                  ", radius_px: float) -> " FL_TABLE),
          nb::arg("image"), nb::arg("fits"), nb::arg("settings"), nb::arg("profile"),
          nb::arg("expected_xy_px"), nb::arg("radius_px"), "As find_spots, one row per expected position.");
    g.def("fwhm", &widths, nb::arg("profile"), nb::arg("xy_px"), "FWHM of the profile at positions.");
    g.def("render_spots", &render, nb::arg("image"), nb::arg("spots"), nb::arg("kind"), nb::arg("radius_q"),
          "Adds pixel-integrated spots (x, y, flux, S_xx, S_xy, S_yy, parameter) to a float32 image.");
    g.def("expose", &expose_image, nb::arg("light_e"), nb::arg("sky"), nb::arg("detector"), nb::arg("seed"),
          nb::arg("threads") = 1,
          "uint16 image: Poisson and read noise on light + sky (level, slope_x, slope_y), then detector "
          "(gain_e_adu, read_noise_e, bias_adu, full_well_e).");
    nb::class_<KeptLights>(g, "Lights", "What shines in an image, in electrons.")
        .def("__init__", &lights_init, nb::arg("spots"), nb::arg("kind"), nb::arg("radius_q"),
             nb::arg("pixels"), nb::arg("electrons"),
             "Spots as of `render_spots`, and `electrons` in single `pixels`: places row by row.");
    g.def("expose_lights", &expose_painted, nb::arg("lights"), nb::arg("shape"), nb::arg("sky"),
          nb::arg("detector"), nb::arg("seed"), nb::arg("threads") = 1,
          "The image (rows, columns) that `expose` makes of lights that are rendered into one of `shape`, "
          "without painting it as a whole first.");
    g.def(
        "wave_sums", &wave_sums, nb::arg("xy"), nb::arg("waves"),
        "(N,) sums of the cosines of plane waves (k_x, k_y, phase) at places (N, 2); NaN where one is NaN.");
}
