// The casting mesh and the shadow kernels of a model that changes its shape
// (docs/shadows.md#kernels-of-animated-models).
#pragma once

#include <array>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <tuple>
#include <utility>
#include <vector>

#include "render/model/animated_model.hpp"
#include "render/model/shadow_mesh.hpp"
#include "render/shadow/kernels/carried_kernels.hpp"
#include "render/shadow/kernels/kernel_direction.hpp"

namespace penumbra {

// Kernels are generated for shapes that are at most this far apart, and carried to those between.
inline constexpr double kKernelKeyStep_s = 0.1;
// A longer animation has this number of steps between its kernels, which are then longer.
inline constexpr int kMaxKernelSteps = 64;
// Minimum mean IoU of the layers of carried kernels and of a field for the same light.
inline constexpr double kMinCarriedUmbra = 0.92;
inline constexpr double kMinCarriedPenumbra = 0.97;

class AnimatedCaster {
 public:
  // `groups`: see make_shadow_mesh().
  AnimatedCaster(std::shared_ptr<const AnimatedModel> model, std::vector<std::string> groups);

  // Returns the mesh in a shape of the model. It is welded once, in the shape of time 0. Returns
  // nullopt if this shape has other faces, or if vertices that were welded are apart.
  [[nodiscard]] std::optional<ShadowMesh> mesh_of(const Model& shape) const;

  // How kernels are made.
  struct Kernels {
    KernelDirection direction;
    KernelSource source = KernelSource::automatic;
    friend auto operator<=>(const Kernels&, const Kernels&) = default;
  };
  // Returns the kernels at a time of the animation; `positions` are those of mesh_of() then. Counts
  // the sets that were generated for it. Requires suits() for these kernels.
  [[nodiscard]] ShadowKernels kernels_at(const Kernels& by, double time_s,
                                         std::span<const glm::vec3> positions, int& generated);
  // Returns the discs of the parts, between those of the same two shapes; only their radii are
  // meaningful. See kernels_at().
  [[nodiscard]] std::vector<PartDisc> parts_at(const Kernels& by, double time_s, int& generated);
  // Returns the discs of the parts as a field has them, seen along `direction`; `mesh` is that of
  // mesh_of() at this time. The radii are between those of two shapes at most kKernelKeyStep_s
  // apart, and so are the distances of the centres from the mean of the part's vertices. Returns
  // nullopt if one of the two shapes has another mesh. Counts the sets that were generated for it.
  [[nodiscard]] std::optional<std::vector<PartDisc>> field_parts_at(
      const KernelDirection& direction, double time_s, const ShadowMesh& mesh, int& generated);

  // How the layers are used.
  struct Use {
    LightMode light_mode = LightMode::proportional;
    double umbra_height = 0.0;  // h_u over the object's scale [m]
    friend auto operator<=>(const Use&, const Use&) = default;
  };
  // Mean IoU with the layers of a field; 0 if there are none, because a shape has other faces.
  struct Agreement {
    double umbra = 0.0, penumbra = 0.0;
    [[nodiscard]] bool is_sufficient() const {
      return umbra >= kMinCarriedUmbra && penumbra >= kMinCarriedPenumbra;
    }
  };
  // Compares the layers at up to 10 times of the animation with those of fields. The light is at
  // the zenith, and the middle of the object at 0.45 of the umbra's height.
  [[nodiscard]] const Agreement& agreement(const Kernels& by, const Use& use);
  // Returns true if carried kernels draw the object well enough.
  [[nodiscard]] bool suits(const Kernels& by, const Use& use) {
    return agreement(by, use).is_sufficient();
  }

 private:
  struct Key {
    std::optional<CarriedKernels> kernels;
    std::vector<PartDisc> parts;  // may be empty
  };
  struct Times {
    int before = 0, after = 0;  // keys
    double share = 0.0;         // of the key after
  };
  [[nodiscard]] static Times times_at(double time_s, int steps, double step_s);
  [[nodiscard]] double time_of(int key) const { return step_s_ * key; }
  [[nodiscard]] std::optional<ShadowMesh> mesh_at(double time_s) const;
  [[nodiscard]] const CarriedKernels& key_kernels(const Kernels& by, int key, int& generated);
  [[nodiscard]] const std::vector<PartDisc>& key_parts(const Kernels& by, int key, int& generated);
  [[nodiscard]] const std::vector<PartDisc>& field_key(const KernelDirection& direction, int key,
                                                       double time_s, int& generated);
  [[nodiscard]] bool has_one_mesh() const;
  [[nodiscard]] Agreement compare(const Kernels& by, const Use& use);

  std::shared_ptr<const AnimatedModel> model_;
  std::shared_ptr<const Model> first_;  // shape at time 0; null if there is none
  ShadowMesh mesh_;                     // of first_
  double max_gap_ = 0.0;                // between welded vertices [m]
  int steps_ = 0;                       // between keys of kernels
  double step_s_ = 0.0;
  int field_steps_ = 0;  // between keys of fields, of which there may be more
  double field_step_s_ = 0.0;
  mutable std::optional<bool> one_mesh_;  // whether the shapes of all keys have this mesh
  std::map<std::pair<Kernels, int>, Key> keys_;
  // Centres are relative to the means of the parts' vertices. Empty: the shape has another mesh.
  std::map<std::pair<KernelDirection, int>, std::vector<PartDisc>> field_keys_;
  std::map<std::pair<Kernels, Use>, Agreement> agreements_;
};

}  // namespace penumbra
