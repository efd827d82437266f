#include "render/model/cut_out.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <glm/common.hpp>

namespace penumbra {
namespace {

constexpr int kVisibilityDepth = 5;   // maximum subdivision in the search for visible regions
constexpr double kFinestStep = 0.25;  // triangles this small are not subdivided [texels]
constexpr int kHalvings = 6;          // bisections of an edge to find the alpha cutoff

struct TexelSpan {
  std::int64_t first = 0, last = -1;  // inclusive
};

// Maps a range of unwrapped texels of a row to texels of the texture. The second span is for a
// wrap-around.
std::array<TexelSpan, 2> wrapped(std::int64_t first, std::int64_t last, std::int64_t size,
                                 TextureWrap wrap) {
  const auto floor_div = [](std::int64_t a, std::int64_t b) { return (a - ((a % b) + b) % b) / b; };
  if (wrap == TextureWrap::clamp) {
    const std::int64_t end = size - 1;
    return {
        TexelSpan{std::clamp<std::int64_t>(first, 0, end), std::clamp<std::int64_t>(last, 0, end)},
        {}};
  }
  const TexelSpan all{0, size - 1};
  if (last - first + 1 >= size) return {all, {}};
  const std::int64_t round = floor_div(first, size);
  const std::int64_t begin = first - round * size;
  const std::int64_t end = last - round * size;
  if (wrap == TextureWrap::repeat) {
    if (end < size) return {TexelSpan{begin, end}, {}};
    return {TexelSpan{begin, size - 1}, TexelSpan{0, end - size}};
  }
  if (end >= size) return {all, {}};
  if (round % 2 == 0) return {TexelSpan{begin, end}, {}};
  return {TexelSpan{size - 1 - end, size - 1 - begin}, {}};
}

std::int64_t floor_of(double x) {
  return static_cast<std::int64_t>(std::floor(std::clamp(x, -1e15, 1e15)));
}

}  // namespace

AlphaPyramid::AlphaPyramid(const Texture& texture, const TextureSampling& sampling)
    : width_(texture.width), height_(texture.height), sampling_(sampling) {
  Level level{width_, height_, {}, {}};
  level.min_alpha.resize(texture.rgba.size() / 4);
  for (std::size_t i = 0; i < level.min_alpha.size(); ++i)
    level.min_alpha[i] = texture.rgba[4 * i + 3];
  level.max_alpha = level.min_alpha;
  levels_.push_back(std::move(level));
  while (levels_.back().width > 1 || levels_.back().height > 1) {
    const Level& fine = levels_.back();
    Level coarse{(fine.width + 1) / 2, (fine.height + 1) / 2, {}, {}};
    const auto cells = static_cast<std::size_t>(coarse.width * coarse.height);
    coarse.min_alpha.assign(cells, 255);
    coarse.max_alpha.assign(cells, 0);
    for (std::int64_t y = 0; y < fine.height; ++y) {
      for (std::int64_t x = 0; x < fine.width; ++x) {
        const auto from = static_cast<std::size_t>(y * fine.width + x);
        const auto to = static_cast<std::size_t>((y / 2) * coarse.width + x / 2);
        coarse.min_alpha[to] = std::min(coarse.min_alpha[to], fine.min_alpha[from]);
        coarse.max_alpha[to] = std::max(coarse.max_alpha[to], fine.max_alpha[from]);
      }
    }
    levels_.push_back(std::move(coarse));
  }
}

AlphaPyramid::Range AlphaPyramid::range(const glm::dvec2& low, const glm::dvec2& high) const {
  // Linear filtering also reads the texels next to those that the rectangle touches.
  const double shift = sampling_.smooth_near ? 0.5 : 0.0;
  const std::int64_t more = sampling_.smooth_near ? 1 : 0;
  const glm::dvec2 a = low * size() - shift;
  const glm::dvec2 b = high * size() - shift;
  const auto columns = wrapped(floor_of(a.x), floor_of(b.x) + more, width_, sampling_.wrap_s);
  const auto rows = wrapped(floor_of(a.y), floor_of(b.y) + more, height_, sampling_.wrap_t);
  std::uint8_t min_alpha = 255;
  std::uint8_t max_alpha = 0;
  for (const TexelSpan& row : rows) {
    for (const TexelSpan& column : columns) {
      const std::int64_t longest = std::max(row.last - row.first, column.last - column.first);
      std::size_t n = 0;
      while (n + 1 < levels_.size() && (longest >> n) > 2) ++n;
      const Level& level = levels_[n];
      for (std::int64_t y = row.first >> n; row.last >= row.first && y <= row.last >> n; ++y) {
        for (std::int64_t x = column.first >> n;
             column.last >= column.first && x <= column.last >> n; ++x) {
          const auto cell = static_cast<std::size_t>(y * level.width + x);
          min_alpha = std::min(min_alpha, level.min_alpha[cell]);
          max_alpha = std::max(max_alpha, level.max_alpha[cell]);
        }
      }
    }
  }
  return {min_alpha / 255.0, max_alpha / 255.0};
}

double AlphaPyramid::at(const glm::dvec2& texcoord) const {
  const Level& texels = levels_.front();
  const auto texel = [&](std::int64_t x, std::int64_t y) {
    const std::int64_t column = wrapped(x, x, width_, sampling_.wrap_s)[0].first;
    const std::int64_t row = wrapped(y, y, height_, sampling_.wrap_t)[0].first;
    return texels.min_alpha[static_cast<std::size_t>(row * width_ + column)] / 255.0;
  };
  const glm::dvec2 place = texcoord * size() - (sampling_.smooth_near ? 0.5 : 0.0);
  const std::int64_t x = floor_of(place.x);
  const std::int64_t y = floor_of(place.y);
  if (!sampling_.smooth_near) return texel(x, y);
  const glm::dvec2 t = place - glm::dvec2(static_cast<double>(x), static_cast<double>(y));
  return glm::mix(glm::mix(texel(x, y), texel(x + 1, y), t.x),
                  glm::mix(texel(x, y + 1), texel(x + 1, y + 1), t.x), t.y);
}

FaceOpacity::FaceOpacity(const Model& model, const Mesh& mesh) : mesh_(mesh) {
  const auto material = static_cast<std::size_t>(mesh.material);
  if (mesh.material >= 0 && material < model.materials.size()) {
    material_ = model.materials[material];
  }
  if (material_.alpha_mode == AlphaMode::opaque) return;
  double min_alpha = static_cast<double>(material_.base_color.a);
  for (const glm::vec4& color : mesh.colors) {
    min_alpha = std::min(min_alpha, static_cast<double>(material_.base_color.a * color.a));
  }
  const MaterialTexture& texture = material_.base_color_texture;
  const auto& texcoords = texture.texcoords == 1 ? mesh.texcoords_2 : mesh.texcoords;
  if (texture.image >= 0 && texcoords.size() == mesh.positions.size()) {
    texcoords_ = &texcoords;
    alpha_.emplace(*model.textures[static_cast<std::size_t>(texture.image)], texture.sampling);
    min_alpha *= alpha_->range({0.0, 0.0}, {1.0, 1.0}).min_alpha;
  }
  const bool mask = material_.alpha_mode == AlphaMode::mask;
  all_whole_ = mask ? min_alpha >= static_cast<double>(material_.alpha_cutoff) : min_alpha > 0.0;
}

FaceOpacity::Face FaceOpacity::face(std::size_t index) const {
  const auto corner = [&](std::size_t i) {
    const std::uint32_t vertex = mesh_.indices[i];
    Corner result{glm::dvec3(mesh_.positions[vertex]), glm::dvec2(0.0),
                  static_cast<double>(material_.base_color.a)};
    if (texcoords_ != nullptr) result.texcoord = glm::dvec2((*texcoords_)[vertex]);
    if (!mesh_.colors.empty()) result.factor *= static_cast<double>(mesh_.colors[vertex].a);
    return result;
  };
  return {corner(index), corner(index + 1), corner(index + 2)};
}

glm::dvec2 FaceOpacity::Face::min_texcoord() const {
  return glm::min(a.texcoord, glm::min(b.texcoord, c.texcoord));
}

glm::dvec2 FaceOpacity::Face::max_texcoord() const {
  return glm::max(a.texcoord, glm::max(b.texcoord, c.texcoord));
}

FaceVisibility FaceOpacity::bounds(const Face& face) const {
  const AlphaPyramid::Range texture =
      alpha_ ? alpha_->range(face.min_texcoord(), face.max_texcoord()) : AlphaPyramid::Range{};
  const double max_alpha =
      texture.max_alpha * std::max({face.a.factor, face.b.factor, face.c.factor});
  if (material_.alpha_mode == AlphaMode::blend) {
    return max_alpha > 0.0 ? FaceVisibility::whole : FaceVisibility::hidden;
  }
  const auto cutoff = static_cast<double>(material_.alpha_cutoff);
  if (max_alpha < cutoff) return FaceVisibility::hidden;
  const double min_alpha =
      texture.min_alpha * std::min({face.a.factor, face.b.factor, face.c.factor});
  return min_alpha >= cutoff ? FaceVisibility::whole : FaceVisibility::partial;
}

// Returns the opacity minus the alpha cutoff.
double FaceOpacity::excess(const Corner& corner) const {
  const double alpha = alpha_ ? alpha_->at(corner.texcoord) : 1.0;
  return corner.factor * alpha - static_cast<double>(material_.alpha_cutoff);
}

template <class Visitor>
bool FaceOpacity::walk(const Face& face, int depth, const Visitor& visit) const {
  const auto between = [](const Corner& p, const Corner& q, double t) {
    return Corner{glm::mix(p.position, q.position, t), glm::mix(p.texcoord, q.texcoord, t),
                  glm::mix(p.factor, q.factor, t)};
  };
  const FaceVisibility visibility = bounds(face);
  if (visibility == FaceVisibility::hidden) return true;
  if (visibility == FaceVisibility::whole) return visit(face.a, face.b, face.c);
  const auto& [a, b, c] = face;
  glm::dvec2 extent(0.0);
  if (alpha_) {
    extent = (face.max_texcoord() - face.min_texcoord()) * alpha_->size();
  }
  if (depth > 0 && std::max(extent.x, extent.y) > kFinestStep) {
    const Corner ab = between(a, b, 0.5);
    const Corner bc = between(b, c, 0.5);
    const Corner ca = between(c, a, 0.5);
    return walk({a, ab, ca}, depth - 1, visit) && walk({ab, b, bc}, depth - 1, visit) &&
           walk({ca, bc, c}, depth - 1, visit) && walk({ab, bc, ca}, depth - 1, visit);
  }
  // Clips the triangle at the cutoff: bisects an edge, then interpolates linearly.
  const auto crossing = [&](const Corner& p, const Corner& q, double over_p, double over_q) {
    double from = 0.0, to = 1.0;
    for (int step = 0; step < kHalvings; ++step) {
      const double middle = 0.5 * (from + to);
      const double over_middle = excess(between(p, q, middle));
      if ((over_middle >= 0.0) == (over_p >= 0.0)) {
        from = middle;
        over_p = over_middle;
      } else {
        to = middle;
        over_q = over_middle;
      }
    }
    return between(p, q, from + (to - from) * over_p / (over_p - over_q));
  };
  const std::array<Corner, 3> corners = {a, b, c};
  const std::array<double, 3> over = {excess(a), excess(b), excess(c)};
  std::vector<Corner> seen;
  for (std::size_t i = 0; i < 3; ++i) {
    const std::size_t next = (i + 1) % 3;
    if (over[i] >= 0.0) seen.push_back(corners[i]);
    if ((over[i] >= 0.0) != (over[next] >= 0.0)) {
      seen.push_back(crossing(corners[i], corners[next], over[i], over[next]));
    }
  }
  for (std::size_t i = 1; i + 1 < seen.size(); ++i) {
    if (!visit(seen[0], seen[i], seen[i + 1])) return false;
  }
  return true;
}

FaceVisibility FaceOpacity::visibility(std::size_t index) const {
  if (all_whole_) return FaceVisibility::whole;
  const Face whole = face(index);
  const FaceVisibility coarse = bounds(whole);
  if (coarse != FaceVisibility::partial) return coarse;
  const bool all_hidden = walk(whole, kVisibilityDepth,
                               [](const Corner&, const Corner&, const Corner&) { return false; });
  return all_hidden ? FaceVisibility::hidden : FaceVisibility::partial;
}

void FaceOpacity::append_visible(std::size_t index, int depth,
                                 std::vector<glm::vec3>& corners) const {
  walk(face(index), depth, [&corners](const Corner& a, const Corner& b, const Corner& c) {
    for (const Corner* corner : {&a, &b, &c}) corners.emplace_back(corner->position);
    return true;
  });
}

bool has_cut_outs(const Model& model) {
  return std::any_of(model.meshes.begin(), model.meshes.end(), [&model](const Mesh& mesh) {
    const FaceOpacity opacity(model, mesh);
    for (std::size_t i = 0; !opacity.all_whole() && i + 2 < mesh.indices.size(); i += 3) {
      if (opacity.visibility(i) == FaceVisibility::partial) return true;
    }
    return false;
  });
}

int cut_out_depth(const Model& model, std::size_t max_triangles) {
  constexpr int kMaxDepth = 7;
  std::vector<FaceOpacity> opacities;
  for (const Mesh& mesh : model.meshes) opacities.emplace_back(model, mesh);
  const auto is_affordable = [&](int depth) {
    std::vector<glm::vec3> corners;
    std::size_t triangles = 0;
    for (std::size_t m = 0; m < model.meshes.size(); ++m) {
      const Mesh& mesh = model.meshes[m];
      const FaceOpacity& opacity = opacities[m];
      for (std::size_t i = 0; !opacity.all_whole() && i + 2 < mesh.indices.size(); i += 3) {
        if (opacity.visibility(i) != FaceVisibility::partial) continue;
        corners.clear();
        opacity.append_visible(i, depth, corners);
        triangles += corners.size() / 3;
        if (triangles > max_triangles) return false;
      }
    }
    return true;
  };
  int depth = kMaxDepth;
  while (depth > 0 && !is_affordable(depth)) --depth;
  return depth;
}

std::string warning_of_cut_outs(const std::string& file) {
  return fmt::format(
      "{}: its materials cut holes into faces (alphaMode MASK), and whole faces cast; the "
      "techniques field, simple, walls and hard cast what is seen",
      file);
}

}  // namespace penumbra
