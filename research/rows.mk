# Lists of rows of the Makefile: which methods each page of results compares.

# what rules give: memory and density by hand behind a learned denoiser, and `ours` with a density by rule
RULES := accumulate,accumulate/contrast,accumulate/variance,accumulate/denoised-variance,accumulate/tuned,accumulate/fast,accumulate/intel,ours/by-rule
CONTROLS := ours,ours/A2,ours/latent,ours/latent-stateless,ours/latent-by-rule,ours/latent-initial,oidn,oidn/filled,oidn-intel/filled,oidn/tuned,oidn/half,$(RULES)

# the rows of the README's figure and table
README := ours,ours/paper,accumulate/tuned,accumulate/fast,accumulate/contrast,oidn,nppd,svgf

# the networks of the paper, developed, and their ablations
LATENT := ours/latent,ours/latent-A1,ours/latent-A2,ours/latent-B1,ours/latent-B2,ours/latent-C,ours/latent-small,ours/latent-stateless,ours/latent-by-rule,ours/latent-flat,ours/latent-initial

# the paper's recipe and its ablations
PAPER := ours/paper,ours/paper-appo,ours/paper-A1,ours/paper-A2,ours/paper-flat,ours/paper-B1,ours/paper-B2,ours/paper-C

# pairs of rows that differ in what the paper claims, by our recipe and by the paper's
CLAIMED := ours,ours/A1,ours/A2,$(LATENT),$(PAPER)

# the paper's Table 1, its ablations, and the methods they are compared with; at the paper's budgets
TABLE1 := $(CLAIMED),ours/flat,imcd,imcd/history,ntas,ntas/history,nppd,nppd/history,dasr,restir+oidn,svgf,oidn,oidn/retrained,restir,mean,oidn/tuned,oidn-intel,$(RULES)
BUDGETS := 0.01,0.1,0.3,0.5,1,2,4
TABLE1_720 := mean,ours,ours/A2,ours/latent,ours/latent-A1,ours/latent-A2,ours/paper,ours/paper-A2,imcd,ntas,dasr,nppd,svgf,oidn,oidn/retrained,accumulate/tuned,accumulate/fast

# published denoisers, with their own history and with that of ours
PUBLISHED := imcd,imcd/history,ntas,ntas/history,nppd,nppd/history,svgf,bmfr,cross,oidn/retrained

# rows of the page of unseen scenes: rules, learning and what both are compared with
UNSEEN := $(CONTROLS),ours/A1,ours/latent-A2,oidn-intel,ours/paper,$(PUBLISHED)

# the nearest rivals
RIVALS := ours,ours/A1,ours/A2,ours/latent,ours/latent-A2,oidn/tuned,oidn-intel,accumulate/contrast,accumulate/tuned,ours/by-rule

# rows on scenes by others, and those whose order is compared on every preset
BY_OTHERS := mean,ours,ours/A1,ours/A2,ours/latent,ours/latent-A2,ours/latent-by-rule,ours/paper,oidn,oidn-intel,oidn/tuned,oidn/half,dasr,$(RULES),$(PUBLISHED)
EIGHT := accumulate/tuned,ours/by-rule,ours/A2,ours,oidn,oidn/tuned,accumulate/contrast,nppd

# rows that are compared at two sizes, and the clips of preset `real` at 640x360
SIZED := ours,ours/A2,ours/paper,accumulate/tuned,accumulate/fast,accumulate/contrast,oidn,oidn/tuned,nppd,svgf
OWN_CAMERAS := living-room,classroom,staircase2,veach-mis,cornell_box_picture,isometric-room,office-room,low-poly-jungle-scene,shanghai,snowy-hut

# clips of preset `hd`: those of `mini`, and those by others where they are
HD_SCENES := city,temple,hall,ripples$(if $(RLBENCH_SCENES),$(comma)$(OWN_CAMERAS))

# rows of the page of takes
TAKES := $(RIVALS),ours/lag,$(PUBLISHED)

# rows with a memory, with and without a test of their history, and two without
RECOVERING := ours,ours/lag,ours/latent,accumulate/contrast,accumulate/tuned,oidn/tuned,oidn-intel,imcd,imcd/history,ntas,ntas/history,nppd,nppd/history,svgf,bmfr

# rows that carry something from frame to frame
CARRYING := ours,ours/latent,ours/paper,accumulate/tuned,accumulate/fast,accumulate/contrast,ntas,ntas/history,imcd/history,nppd,nppd/history,svgf,bmfr,cross,eaw/still

# rows whose images of scenes by others are shown
PAINTED := accumulate/contrast,oidn,ours,accumulate/tuned

# rivals that need no training data, and rows beside them
REGRESSIONS := bmfr,bmfr/filled,cross,cross/pilots,cross/contrast,svgf,oidn,ours
TWELVE_UNSEEN := $(shell seq -s , -f 'generated-%g' 400 411)

# learned rows near the front and two filters, in all backends
SPEED := oidn-intel,oidn/tuned,accumulate/contrast,ours,ours/latent,ntas,svgf,bmfr

# the same on a GPU, and the rows whose papers report times on one
SPEED_GPU := oidn,oidn-intel,accumulate/tuned,accumulate/fast,ours,svgf,eaw,bmfr,ntas,imcd,dasr,nppd

# rows of the picture of the viewer
VIEWED := mean,svgf,imcd,ntas,oidn,oidn/tuned,accumulate/contrast,ours,ours/latent

# rows of the videos of each scene
FILMED := mean,oidn,svgf,ntas,ours
